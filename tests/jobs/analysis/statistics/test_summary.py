"""Summaries against numbers worked by hand, and of tables that lack something."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from jobs.analysis.statistics import summarise


def _runs(arms: list[str], **columns: Any) -> pa.Table:
    count = len(arms)
    basis: dict[str, Any] = {"arm": arms, "sweep": [""] * count, "episodes": [5] * count, "steps": [50] * count}
    nothing = {"train_time": pa.nulls(count, pa.int64()), "censored": pa.nulls(count, pa.bool_())}
    return pa.table(basis | nothing | columns)


def test_summary_by_hand() -> None:
    """One row per arm in order of appearance; a capped run counts with its cap, and as censored."""
    runs = pa.table(
        {
            "arm": ["B", "B", "A"],
            "sweep": [""] * 3,
            "train_time": [100, 300, 5000],
            "censored": [False, False, True],
            "episodes": [100, 300, 5000],
            "steps": [10, 30, 50],
        }
    )
    first, second = summarise(runs).to_pylist()
    assert (first["arm"], first["runs"], first["mean_train_time"], first["num_censored"]) == ("B", 2, 200.0, 0)
    assert first["standard_deviation"] == pytest.approx(np.sqrt(2 * 100**2))
    assert (first["interval_low"], first["interval_high"]) == (100, 300)
    assert (first["interquartile_mean_low"], first["interquartile_mean_high"]) == (100, 300)
    assert (second["arm"], second["mean_train_time"], second["num_censored"], second["steps"]) == ("A", 5000.0, 1, 50)


def test_summary_without_criterion() -> None:
    """Where nothing counts as trained there are no train times, and no error."""
    (row,) = summarise(_runs(["A"])).to_pylist()
    assert (row["episodes"], row["steps"]) == (5, 50)
    assert "mean_train_time" not in row


def test_sweep_points_have_rows_of_their_own() -> None:
    """Columns named by their axis are not asked: the string of the point is the key."""
    runs = _runs(["A", "A", "A"], sweep=["x=1", "x=2", "x=1"], x=[1, 2, 1])
    assert [(row["sweep"], row["runs"]) for row in summarise(runs).to_pylist()] == [("x=1", 2), ("x=2", 1)]


def test_further_measures() -> None:
    """Mean, interval and standard deviation of the runs that have the measure; without a criterion as well."""
    runs = _runs(
        ["A", "A", "A"],
        adaptation_time=pa.array([50, None, 70], pa.int64()),
        steady_state=pa.array([None] * 3, pa.float64()),
    )
    (row,) = summarise(runs).to_pylist()
    assert row["mean_adaptation_time"] == 60
    assert (row["adaptation_time_low"], row["adaptation_time_high"]) == (50, 70)
    assert row["adaptation_time_standard_deviation"] == pytest.approx(np.sqrt(200))
    assert not [name for name in row if "steady_state" in name or "train_time" in name]


def test_measure_that_only_a_later_arm_has() -> None:
    """The first arm's row has the columns too, and null in them; NaN counts as null."""
    runs = _runs(["A", "B"], steady_state=pa.array([float("nan"), -30.0]), train_time=pa.array([None, 70]))
    first, second = summarise(runs.set_column(5, "censored", pa.array([None, True]))).to_pylist()
    assert first["mean_steady_state"] is None
    assert (first["mean_train_time"], first["median"], first["num_censored"]) == (None, None, None)
    assert (second["mean_steady_state"], second["steady_state_low"]) == (-30, -30)
    assert (second["steady_state_standard_deviation"], second["num_censored"]) == (None, 1)


def test_return_of_the_last_tenth() -> None:
    """With its median, by hand: the mean of 1, 2 and 6 is 3, the median 2; unknown where it is of one run."""
    runs = _runs(["A", "A", "A", "B", "B"], last_tenth_return=pa.array([1.0, 2.0, 6.0, 5.0, None]))
    first, second = summarise(runs).to_pylist()
    assert (first["mean_last_tenth_return"], first["median_last_tenth_return"]) == (3, 2)
    assert first["last_tenth_return_standard_deviation"] == pytest.approx(np.sqrt(7))
    assert (second["mean_last_tenth_return"], second["median_last_tenth_return"]) == (None, None)


def test_returns_that_overflow() -> None:
    """Nothing but that is known of their arm; the others are summarised."""
    runs = _runs(["A", "A", "B"], last_tenth_return=pa.array([float("inf"), 2.0, 3.0]))
    first, second = summarise(runs).to_pylist()
    assert first["mean_last_tenth_return"] == float("inf")
    spread = ("low", "high", "standard_deviation")
    assert [first[f"last_tenth_return_{name}"] for name in spread] == [None] * 3
    assert second["mean_last_tenth_return"] == 3


def test_spread_of_one_run_is_unknown() -> None:
    """One run says nothing of how runs differ."""
    runs = _runs(["A"], train_time=[70]).set_column(5, "censored", pa.array([False]))
    (row,) = summarise(runs).to_pylist()
    assert (row["mean_train_time"], row["standard_deviation"]) == (70, None)
