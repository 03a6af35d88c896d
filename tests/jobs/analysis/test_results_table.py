"""The table of results says what an experiment measures, and nothing that it does not."""

from __future__ import annotations

from typing import Any

import pyarrow as pa

from jobs.analysis.results_table import results_table

BASE: dict[str, Any] = {"arm": "APEL", "sweep": "", "runs": 3, "episodes": 1200, "steps": 6_000_000}
TIMES = {
    "mean_train_time": 1250.4, "interval_low": 1000.0, "interval_high": 1500.6, "standard_deviation": 99.5,
    "interquartile_mean": 1200.0, "median": 1249.6, "num_censored": 1,
}  # fmt: skip
ADAPTATION = {
    "mean_adaptation_time": 250.4, "adaptation_time_low": 200.0, "adaptation_time_high": 300.0,
    "adaptation_time_standard_deviation": 9.6,
}  # fmt: skip
STEADY = {
    "mean_steady_state": -2.345, "steady_state_low": -2.5, "steady_state_high": -2.0,
    "steady_state_standard_deviation": 0.25,
}  # fmt: skip


def shown(*parts: dict[str, Any]) -> dict[str, str]:
    """The row of one arm by heading; 2 seconds of wall time."""
    row: dict[str, Any] = dict(BASE)
    for part in parts:
        row |= part
    table = results_table(pa.Table.from_pylist([row]), {"APEL": (2.0, 6e6)})
    assert table.headings[: table.num_names] == (["arm", "sweep"] if row["sweep"] else ["arm"])
    return dict(zip(table.headings, table.rows[0], strict=True))


def test_train_times() -> None:
    """Train time with interval, spread, middle and censored runs; 6 M steps in 2 s are 3 M steps/s."""
    assert shown(TIMES) == {
        "arm": "APEL", "runs": "3", "train time": "1,250", "95 % interval": "1,000 to 1,501", "SD": "100",
        "IQM": "1,200", "median": "1,250", "censored": "1 of 3", "wall time": "2.0 s", "steps/s": "3.0 M",
    }  # fmt: skip


def test_adaptation_times_stand_for_train_times() -> None:
    """Where only episodes after a switch count, that is what is shown; an arm that has none shows dashes."""
    row = shown(TIMES, ADAPTATION)
    assert row["adaptation time"] == "250"
    assert row["SD"] == "10"
    assert "train time" not in row
    assert "IQM" not in row
    assert shown(TIMES, ADAPTATION, {"mean_adaptation_time": None})["adaptation time"] == "-"


def test_steady_state_has_decimals() -> None:
    """Returns are small numbers."""
    row = shown(STEADY)
    assert row["steady state"] == "-2.35"
    assert row["95 % interval"] == "-2.50 to -2.00"
    assert "train time" not in row


def test_without_any_measure_the_episodes_are_shown() -> None:
    """So that the table is never empty."""
    assert shown()["episodes"] == "1,200"


def test_wall_time_is_not_told_by_sweep_point() -> None:
    """It is known by arm only: the same number in every row of an arm would be read as each row's."""
    row = shown(TIMES, {"sweep": "decay=0.1"})
    assert row["sweep"] == "decay=0.1"
    assert "wall time" not in row
