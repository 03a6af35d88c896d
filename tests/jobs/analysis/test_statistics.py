"""Statistics against numbers worked by hand, and against their definition."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jobs.analysis.statistics import bootstrap_interval, interquartile_mean, summarise


def test_interquartile_mean_by_hand() -> None:
    """Of eight values the two smallest and the two largest fall away: (3 + 4 + 5 + 6) / 4."""
    assert interquartile_mean(np.array([6.0, 1, 100, 3, 5, 2, 90, 4])) == 4.5


def test_interval_of_equal_values_is_a_point() -> None:
    """Without spread there is nothing to resample."""
    assert bootstrap_interval(np.full(10, 3.0)) == (3.0, 3.0)
    assert bootstrap_interval(np.array([7.0])) == (7.0, 7.0)


def test_interval_is_that_of_the_normal_approximation() -> None:
    """For many values the interval of the mean is mean ± 1.96 standard errors, to a tenth of one."""
    values = np.random.default_rng(1).normal(10, 2, 400)
    error = values.std(ddof=1) / 20
    low, high = bootstrap_interval(values)
    assert low == pytest.approx(values.mean() - 1.96 * error, abs=0.1 * error * 1.5)
    assert high == pytest.approx(values.mean() + 1.96 * error, abs=0.1 * error * 1.5)


@given(st.lists(st.floats(0, 5000), min_size=2, max_size=30))
def test_interval_holds_the_mean(values: list[float]) -> None:
    """The interval lies within the values and around their mean."""
    low, high = bootstrap_interval(np.array(values))
    slack = 1e-9 * (1 + max(values))
    assert min(values) - slack <= low <= np.mean(values) + slack
    assert np.mean(values) - slack <= high <= max(values) + slack


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
    assert (second["arm"], second["mean_train_time"], second["num_censored"], second["steps"]) == ("A", 5000.0, 1, 50)


def test_summary_without_criterion() -> None:
    """Where nothing counts as trained there are no train times, and no error."""
    columns = {"arm": ["A"], "sweep": [""], "episodes": [5], "steps": [50]}
    nothing = {"train_time": pa.array([None], pa.int64()), "censored": pa.array([None], pa.bool_())}
    runs = pa.table(columns | nothing)
    (row,) = summarise(runs).to_pylist()
    assert (row["episodes"], row["steps"]) == (5, 50)
    assert "mean_train_time" not in row
