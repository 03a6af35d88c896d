"""The table of results says what an experiment measures, and nothing that it does not."""

from __future__ import annotations

from typing import Any

import pyarrow as pa

from jobs.analysis.pages.results_table import results_table

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


RETURN = {
    "mean_last_tenth_return": -1234.5, "last_tenth_return_low": -1300.0, "last_tenth_return_high": -1200.25,
    "last_tenth_return_standard_deviation": 20.5, "median_last_tenth_return": -1230.0,
}  # fmt: skip


def test_without_a_criterion_the_return_is_shown() -> None:
    """Of the last tenth, with its interval, its spread and its median, and the steps that it took."""
    assert shown(RETURN) == {
        "arm": "APEL", "runs": "3", "return, last tenth": "-1,234.50", "95 % interval": "-1,300.00 to -1,200.25",
        "SD": "20.50", "median": "-1,230.00", "steps": "6.0 M", "wall time": "2.0 s", "steps/s": "3.0 M",
    }  # fmt: skip
    assert shown(TIMES, RETURN) == shown(TIMES)
    row = shown(STEADY, RETURN)
    assert (row["steady state"], row["SD"], row["return, last tenth"]) == ("-2.35", "0.25", "-1,234.50")


def test_what_is_unknown_everywhere_is_left_out() -> None:
    """The spread of single runs is unknown, not 0; where any arm has several, the others show dashes."""
    alone = {"runs": 1, "standard_deviation": None, "last_tenth_return_standard_deviation": None}
    assert "SD" not in shown(TIMES, alone)
    assert "95 % interval" not in shown(TIMES, alone)
    assert list(shown(RETURN, alone)) == [
        "arm", "runs", "return, last tenth", "median", "steps", "wall time", "steps/s",
    ]  # fmt: skip
    rows = [{**BASE, **RETURN}, {**BASE, **RETURN, "arm": "A", "last_tenth_return_standard_deviation": None}]
    table = results_table(pa.Table.from_pylist(rows), {})
    assert table.rows[1] == ["A", "3", "-1,234.50", "-", "-", "-1,230.00", "6.0 M"]
