"""Survival against numbers worked by hand and against the plain empirical distribution."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jobs.analysis.statistics.survival import median_train_time, share_solved

times = st.lists(st.integers(1, 50), min_size=1, max_size=40)
watched = st.lists(st.tuples(st.integers(1, 50), st.booleans()), min_size=1, max_size=40)


def test_share_by_hand() -> None:
    """Solved at 1 and 3, censored at 2 and 4: S(1) = 3/4; at 3 two runs are left, S(3) = 3/4 · 1/2 = 3/8."""
    curve = share_solved(np.array([1, 2, 3, 4]), np.array([False, True, False, True]))
    assert curve.episodes.tolist() == [0, 1, 2, 3, 4]
    assert curve.share.tolist() == [0, 0.25, 0.25, 0.625, 0.625]
    assert curve.at(np.array([0, 0.5, 1, 2.9, 100])).value.tolist() == [0, 0, 0.25, 0.25, 0.625]


def test_band_by_hand() -> None:
    """At S = 3/4 of four runs Greenwood's sum is 1 / (4 · 3); on the scale log(−log S) its root is divided by log S.

    So the ends are S^exp(±1.96 √(1/12) / log S).
    """
    curve = share_solved(np.array([1, 2, 3, 4]), np.array([False, True, False, True]))
    spread = 1.959964 * math.sqrt(1 / 12) / abs(math.log(0.75))
    assert curve.low[1] == pytest.approx(1 - 0.75 ** math.exp(-spread), abs=1e-6)
    assert curve.high[1] == pytest.approx(1 - 0.75 ** math.exp(spread), abs=1e-6)


def test_band_where_nothing_or_all_is_solved() -> None:
    """None of ten: the share p under which that has probability (1 − p)^10 = 2.5 %; all of ten: its mirror image."""
    edge = 1 - 0.025**0.1
    never = share_solved(np.full(10, 5000), np.ones(10, dtype=bool))
    assert never.share.tolist() == [0, 0]
    assert never.low.tolist() == [0, 0]
    assert never.high == pytest.approx(edge)
    always = share_solved(np.full(10, 70), np.zeros(10, dtype=bool))
    assert always.share.tolist() == [0, 1]
    assert (always.low[1], always.high[1]) == pytest.approx((1 - edge, 1))


def test_run_solved_at_zero() -> None:
    """A run that is solved before its first episode needs no step before it."""
    curve = share_solved(np.array([0, 4]), np.array([False, False]))
    assert (curve.episodes.tolist(), curve.share.tolist()) == ([0, 4], [0.5, 1])


@settings(deadline=None)
@given(times)
def test_without_censoring_it_is_the_empirical_distribution(values: list[int]) -> None:
    """The share solved by t is the share of train times ≤ t."""
    array = np.array(values)
    curve = share_solved(array, np.zeros(len(array), dtype=bool))
    episodes = np.arange(0, 60)
    expected = (array[:, None] <= episodes).mean(axis=0)
    np.testing.assert_allclose(curve.at(episodes).value, expected, rtol=0, atol=1e-12)


@settings(deadline=None)
@given(watched)
def test_share_never_falls_and_lies_in_its_band(runs: list[tuple[int, bool]]) -> None:
    """The share rises within [0, 1]; its band holds it; it is no smaller than the share known to be solved."""
    values, flags = np.array([time for time, _ in runs]), np.array([flag for _, flag in runs])
    curve = share_solved(values, flags)
    assert np.all(np.diff(curve.episodes) > 0)
    assert np.all(np.diff(curve.share) >= 0)
    assert np.all((curve.low <= curve.share) & (curve.share <= curve.high))
    assert np.all((curve.low >= 0) & (curve.high <= 1))
    counted = ((values[:, None] <= curve.episodes) & ~flags[:, None]).mean(axis=0)
    assert np.all(curve.share >= counted - 1e-12)


@settings(deadline=None)
@given(watched)
def test_median_lies_in_its_interval(runs: list[tuple[int, bool]]) -> None:
    """Also where its upper end, or all of it, was not seen."""
    values, flags = np.array([time for time, _ in runs]), np.array([flag for _, flag in runs])
    value, low, high = median_train_time(values, flags)
    assert low <= value <= high


def test_median_by_hand() -> None:
    """Of five known times the third; with three of five at the cap it was not seen."""
    assert median_train_time(np.array([5, 1, 4, 2, 3]), np.zeros(5, dtype=bool)).value == 3
    assert median_train_time(np.array([1, 2, 9, 9, 9]), np.array([0, 0, 1, 1, 1], dtype=bool)).value == math.inf


def test_median_of_a_hundred() -> None:
    """50 of 100 runs solved by 50 is half, whatever the product of 50 factors rounds to.

    The sign test's interval goes from the 40th to the 61st of the ordered times.
    """
    value, low, high = median_train_time(np.arange(1, 101), np.zeros(100, dtype=bool))
    assert value == 50
    assert low == pytest.approx(40, abs=1)
    assert high == pytest.approx(61, abs=1)


def test_bad_times_are_refused() -> None:
    """Null train times (no criterion), times without flags, negative times."""
    with pytest.raises(ValueError, match="found 1 of 1 values that are not finite"):
        share_solved(np.array([np.nan]), np.array([True]))
    with pytest.raises(ValueError, match=r"found times \(2,\) and flags \(1,\), expected one of each per run"):
        share_solved(np.array([1, 2]), np.array([True]))
    with pytest.raises(ValueError, match="found a train time of -1, expected none below 0"):
        share_solved(np.array([-1]), np.array([True]))
