"""Levels of thresholds against their intervals, the t-test, and numbers worked by hand; Holm's correction."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from apel.numerics.intervals import expanded_levels
from jobs.analysis.statistics.bootstrap import Estimate, Floats, bootstrap_curve
from jobs.reproduction.claims.holm import holm
from jobs.reproduction.claims.resampled import CountedShare, Resampled, level_of
from jobs.reproduction.claims.statistics import Sample, measured


def means(values: Floats) -> Resampled:
    """The mean of some runs."""
    return measured(Sample(values[:, None, None], np.zeros(1)), "mean", "only")


def test_interval_is_read_at_the_expanded_levels() -> None:
    """Of the resamples 0, 1, … 10 000 of five runs: Φ(−2.776 √(5/4)) = 0.00095 of them at either end."""
    found = Resampled(5000.0, np.arange(10_001.0)[:, None], 5).estimate
    assert found == pytest.approx((5000, 9.5, 9990.5), abs=0.1)


@settings(deadline=None)
@given(st.integers(20, 60), st.integers(0, 2**32 - 1), st.floats(0, 0.6))
def test_level_is_below_five_percent_where_the_interval_excludes(num_runs: int, seed: int, threshold: float) -> None:
    """But for a threshold within a resample of the interval's end."""
    found = means(np.random.default_rng(seed).normal(size=num_runs))
    low, high = found.estimate[1:]
    slack = 0.05 * (high - low)
    level = level_of(found, (threshold, np.inf), are_inside=False)
    if low > threshold + slack or high < threshold - slack:
        assert level < 0.05
    if low < threshold - slack and high > threshold + slack:
        assert level > 0.05


@pytest.mark.parametrize("shift", [0.3, 0.6, 1.5, 5.0])
def test_level_of_a_mean_is_that_of_the_t_test(shift: float) -> None:
    """Also far beyond what 10 000 resamples can tell: normal values, 40 runs, t from 2 to 32."""
    values = stats.norm.ppf((np.arange(40) + 0.5) / 40) + shift
    found = level_of(means(values), (0.0, np.inf), are_inside=False)
    expected = stats.ttest_1samp(values, 0.0).pvalue
    assert np.log10(found) == pytest.approx(max(np.log10(expected), 39 * np.log10(0.5)), rel=0.15)


def test_level_where_all_runs_agree() -> None:
    """Twenty equal differences are as telling as twenty of one sign: 2 · ½²⁰. So are those that are the threshold."""
    found = means(np.full(20, -5.0))
    assert level_of(found, (-np.inf, 0.0), are_inside=False) == 2.0**-19
    assert level_of(means(np.zeros(20)), (-np.inf, 0.0), are_inside=False) == 2.0**-19


def test_level_between_two_bounds_is_that_of_the_nearer_one() -> None:
    """Two one-sided tests: a mean of 0 with an error of 0.16 is 1.3 errors from 0.2, and 6 from −1."""
    found = means(stats.norm.ppf((np.arange(40) + 0.5) / 40))
    both = level_of(found, (-1.0, 0.2), are_inside=True)
    assert both == level_of(found, (-np.inf, 0.2), are_inside=True)
    assert 0.15 < both < 0.3
    assert level_of(found, (-1.0, 1.0), are_inside=True) < 1e-6


def test_nothing_is_known_without_finite_resamples() -> None:
    found = Resampled(1.0, np.array([[1.0], [np.nan]]), 20)
    assert found.estimate == Estimate(1.0, -np.inf, np.inf)
    assert found.level(0.0, is_above=True) == 1.0


def test_excess_is_over_the_best_of_the_others() -> None:
    """The first of three points, 1, is 0.5 above the second and 2 below the third. The interval is that of the former
    difference, but that its lower end is read at a confidence of 97.5 %, as one of two.
    """
    values = np.random.default_rng(1).normal(size=(40, 3)) * [0.1, 0.1, 0.1] + [1.0, 0.5, 3.0]
    found = measured(Sample(values[:, None, :], np.arange(3.0)), "mean", "excess")
    nearer = found.drawn[:, 0]
    low = np.quantile(nearer, expanded_levels(40, 0.975)[0])
    high = np.quantile(nearer, expanded_levels(40)[1])
    assert found.estimate == pytest.approx((values[:, 0].mean() - values[:, 1].mean(), low, high))
    curve = bootstrap_curve(values[:, 0] - values[:, 1])
    assert found.estimate.high == pytest.approx(float(curve.high), abs=0.01)
    best = measured(Sample(values[:, None, [1, 0, 2]], np.arange(3.0)), "mean", "excess")
    assert best.estimate.high == pytest.approx(-float(curve.low), abs=0.01)
    assert level_of(best, (-np.inf, 0.0), are_inside=False) < 1e-6
    assert level_of(found, (-np.inf, 0.0), are_inside=False) < 1e-6


def test_equal_points_seldom_exceed() -> None:
    """Of ten points that are equally good the first is said to be worse than the best of them in less than 5 %."""
    draws = np.random.default_rng(2)
    num_wrong = sum(
        measured(Sample(draws.normal(size=(30, 1, 10)), np.arange(10.0)), "mean", "excess").estimate.low > 0
        for _ in range(60)
    )
    assert num_wrong <= 6  # binomial(60, 0.05) is above 6 in 3 % of cases, at the most


def test_level_of_a_share() -> None:
    """Of 20 runs none: twice (1 − q)²⁰, or all."""
    assert CountedShare([False] * 20).level(0.1, is_above=True) == pytest.approx(2 * 0.9**20)
    assert CountedShare([True] * 20).level(0.9, is_above=True) == pytest.approx(2 * 0.9**20)
    assert CountedShare([True, False]).level(0.5, is_above=True) == 1.0


def test_holm_by_hand() -> None:
    """Of four: 4 · 0.01; 3 · 0.015, no less than that before; 2 · 0.02 likewise; and 0.5."""
    assert holm([0.5, 0.01, 0.02, 0.015]) == pytest.approx([0.5, 0.04, 0.045, 0.045])
    assert holm([]) == []
    assert holm([0.6, 0.7]) == [1.0, 1.0]
