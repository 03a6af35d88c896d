"""Comparisons of two arms against numbers worked by hand, scipy's U, and their symmetries."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from jobs.analysis.statistics.comparison import aligned, compare_paired, probability_of_improvement

FEW = 500
arms = st.lists(st.integers(0, 20).map(float), min_size=1, max_size=15).map(np.array)
pairs = st.lists(st.tuples(st.integers(0, 20), st.integers(0, 20)), min_size=1, max_size=15).map(
    lambda rows: np.array(rows, dtype=np.float64).T
)


def test_paired_by_hand() -> None:
    """1 < 2, 3 = 3, 5 > 4, 2 < 6: smaller in two of four runs, half a win for the tie; the means are 11/4 and 15/4."""
    first, second = np.array([1.0, 3, 5, 2]), np.array([2.0, 3, 4, 6])
    found = compare_paired(first, second, smaller_is_better=True)
    assert found.difference.value == -1
    assert found.share_less == 0.5
    assert found.win_probability.value == 2.5 / 4
    turned = compare_paired(first, second, smaller_is_better=False)
    assert turned.share_less == 0.5
    assert turned.win_probability.value == 1.5 / 4


def test_pairs_are_resampled_as_pairs() -> None:
    """Where the second takes one episode longer in every maze, the difference is certain however much mazes differ."""
    first = np.random.default_rng(1).exponential(1000, 50).round()
    found = compare_paired(first, first + 1, smaller_is_better=True)
    assert found.difference == (-1, -1, -1)
    assert found.win_probability == (1, 1, 1)


@settings(deadline=None)
@given(pairs, st.booleans())
def test_paired_turns_its_sign(values: np.ndarray, smaller_is_better: bool) -> None:
    """Exchanging the arms negates the difference and complements the win probability, and exchanges their ends."""
    there = compare_paired(values[0], values[1], smaller_is_better=smaller_is_better, num_resamples=FEW)
    back = compare_paired(values[1], values[0], smaller_is_better=smaller_is_better, num_resamples=FEW)
    value, low, high = there.difference
    assert back.difference == pytest.approx((-value, -high, -low), abs=1e-9)
    value, low, high = there.win_probability
    assert back.win_probability == pytest.approx((1 - value, 1 - high, 1 - low), abs=1e-9)
    assert low <= value + 1e-12
    assert value <= high + 1e-12


def test_probability_by_hand() -> None:
    """Of 1, 4 against 2, 4, 5: 1 is smaller thrice, 4 once and equal once: (4 + ½) / 6."""
    first, second = np.array([1.0, 4]), np.array([2.0, 4, 5])
    assert probability_of_improvement(first, second, smaller_is_better=True).value == 0.75
    assert probability_of_improvement(first, second, smaller_is_better=False).value == 0.25


@settings(deadline=None)
@given(arms, arms, st.booleans())
def test_probabilities_of_both_directions_make_one(first: np.ndarray, second: np.ndarray, smaller: bool) -> None:
    """Either is better, or they tie and share."""
    there = probability_of_improvement(first, second, smaller_is_better=smaller, num_resamples=20)
    back = probability_of_improvement(second, first, smaller_is_better=smaller, num_resamples=20)
    assert there.value + back.value == pytest.approx(1, abs=1e-12)
    assert 0 <= there.low <= there.high <= 1


@settings(deadline=None)
@given(arms, arms)
def test_probability_is_mann_and_whitneys(first: np.ndarray, second: np.ndarray) -> None:
    """U over the number of pairs."""
    statistic = stats.mannwhitneyu(first, second, method="asymptotic").statistic
    found = probability_of_improvement(first, second, smaller_is_better=False, num_resamples=2)
    assert found.value == pytest.approx(statistic / len(first) / len(second), abs=1e-12)


def test_probability_of_normal_arms() -> None:
    """For N(0, 1) against N(1, 1) it is Φ(1 / √2) = 0.760; its interval has the width of Hanley and McNeil (1982).

    They give the variance of the area A for n runs each as (A (1 − A) + (n − 1) (Q₁ + Q₂ − 2 A²)) / n², with
    Q₁ = A / (2 − A) and Q₂ = 2 A² / (1 + A).
    """
    first, second = np.random.default_rng(2).normal([[0.0], [1.0]], size=(2, 400))
    area, low, high = probability_of_improvement(first, second, smaller_is_better=True, num_resamples=2000)
    assert low < stats.norm.cdf(1 / np.sqrt(2)) < high
    spread = area / (2 - area) + 2 * area**2 / (1 + area) - 2 * area**2
    error = np.sqrt((area * (1 - area) + 399 * spread) / 400**2)
    assert (high - low) / (2 * 1.96) == pytest.approx(error, rel=0.1)


def test_one_run_each_is_a_point() -> None:
    """There is nothing to resample."""
    assert probability_of_improvement(np.array([1.0]), np.array([2.0]), smaller_is_better=True) == (1, 1, 1)


def test_bad_arms_are_refused() -> None:
    """Pairs need partners, and every run a number."""
    with pytest.raises(ValueError, match=r"found runs of shapes \(1,\) and \(2,\), expected as many of each"):
        compare_paired(np.zeros(1), np.zeros(2), smaller_is_better=True)
    with pytest.raises(ValueError, match="found no runs, expected at least one"):
        probability_of_improvement(np.zeros(1), np.zeros(0), smaller_is_better=True)


def _runs(train_time: list[int | None]) -> pa.Table:
    """Arm B with runs 1, 0, 2 in this order, arm A with runs 0, 1."""
    return pa.table(
        {
            "arm": ["B", "B", "B", "A", "A"],
            "sweep": ["", "", "", "x=1", "x=1"],
            "run_index": [1, 0, 2, 0, 1],
            "train_time": train_time,
        }
    )


def test_rows_hold_runs_of_one_index() -> None:
    """Whatever their order in the table; a run that one of the arms lacks is left out."""
    found = aligned(_runs([11, 10, 12, 20, 21]), "train_time", [("B", ""), ("A", "x=1")])
    assert found.tolist() == [[10, 20], [11, 21]]


def test_what_cannot_be_aligned_is_refused() -> None:
    """An arm nobody played, values that are not there, runs that are not shared."""
    with pytest.raises(ValueError, match=r"found no runs of \[\('C', ''\)\], expected arms and sweep points among"):
        aligned(_runs([1] * 5), "train_time", [("B", ""), ("C", "")])
    with pytest.raises(ValueError, match="found 4 of 4 values that are not finite"):
        aligned(_runs([None] * 5), "train_time", [("B", ""), ("A", "x=1")])
    alone = _runs([1] * 5).filter(pa.array([False, False, True, True, True]))
    with pytest.raises(ValueError, match="found no run index that all of"):
        aligned(alone, "train_time", [("B", ""), ("A", "x=1")])
    with pytest.raises(ValueError, match="found a run index twice"):
        aligned(pa.concat_tables([_runs([1] * 5)] * 2), "train_time", [("B", ""), ("A", "x=1")])
