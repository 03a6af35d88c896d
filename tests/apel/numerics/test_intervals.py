"""Levels of expanded percentile intervals against numbers worked by hand, and against what they are made for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from apel.numerics.intervals import expanded_levels, two_sided_level


def test_levels_by_hand() -> None:
    """Student's 2.5 % points with 4 and 19 degrees are 2.776 and 2.093: Φ(−2.776 √(5/4)) and Φ(−2.093 √(20/19))."""
    for num_runs, quantile in ((5, 2.776), (20, 2.093)):
        low, high = expanded_levels(num_runs)
        assert low == pytest.approx(stats.norm.cdf(-quantile * np.sqrt(num_runs / (num_runs - 1))), rel=2e-3)
        assert low + high == pytest.approx(1)


def test_many_runs_have_the_plain_levels() -> None:
    """As all corrections for small samples do, this one goes away."""
    assert expanded_levels(10**6) == pytest.approx((0.025, 0.975), abs=1e-6)


def test_two_runs_reach_from_end_to_end() -> None:
    """Student's point is 12.7 with one degree: no resample lies beyond."""
    assert expanded_levels(2)[0] < 1e-60


@pytest.mark.parametrize("num_runs", [3, 5, 30, 100])
@pytest.mark.parametrize("level", [0.01, 0.05, 0.5])
def test_level_is_the_inverse(num_runs: int, level: float) -> None:
    """An interval of confidence 1 − p leaves such a share that leads back to p."""
    assert two_sided_level(num_runs, expanded_levels(num_runs, 1 - level)[0]) == pytest.approx(level)


def test_level_of_a_mean_is_students() -> None:
    """Where resamples are normal with the deviation s √((n − 1) / n) / √n, p is that of the t-test.

    Ten runs with the mean 1 and s = 2 have t = √10 / 2; 1 / (2 √0.9 / √10) deviations of the resamples lie below 0.
    """
    share = stats.norm.cdf(-1 / (2 * np.sqrt(0.9) / np.sqrt(10)))
    assert two_sided_level(10, share) == pytest.approx(2 * stats.t.sf(np.sqrt(10) / 2, 9))
