"""The table of results in words: the same for the terminal, the experiment's page and the reproduction's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

Timings = Mapping[str, tuple[float, float]]
"""Seconds and steps by arm."""
Columns = list[tuple[str, str]]
"""Of one row: each heading with what stands below it."""

_UNKNOWN = "-"
_LEFT_OUT = frozenset({"95 % interval", "SD", "IQM", "median", "censored", "wall time", "steps/s"})
"""Columns that say nothing where they are unknown in every row."""


@dataclass(frozen=True)
class ResultsTable:
    """Headings and rows of text; ``num_names`` of the columns, counted from the left, are names and not numbers."""

    headings: list[str]
    rows: list[list[str]]
    num_names: int


def results_table(summary: pa.Table, timings: Timings) -> ResultsTable:
    """One row per arm and sweep point, with the measures that the experiment has.

    Without a criterion that is the mean return of the last tenth of each run. The wall time is known by arm, so it is
    left out where an arm has several rows; as is what is not known of any row, such as the spread of a single run.
    """
    rows, known = summary.to_pylist(), set(summary.column_names)
    has_sweep = any(row["sweep"] for row in rows)
    found = [_columns(row, known, has_sweep, timings) for row in rows]
    headings = [heading for heading, _ in found[0]] if found else []
    cells = [[cell for _, cell in row] for row in found]
    kept = [
        place
        for place, heading in enumerate(headings)
        if heading not in _LEFT_OUT or any(row[place] != _UNKNOWN for row in cells)
    ]
    shown = [[row[place] for place in kept] for row in cells]
    return ResultsTable([headings[place] for place in kept], shown, 2 if has_sweep else 1)


def _columns(row: Mapping[str, Any], known: set[str], has_sweep: bool, timings: Timings) -> Columns:
    columns = [("arm", row["arm"]), *([("sweep", row["sweep"])] if has_sweep else []), ("runs", str(row["runs"]))]
    has_criterion = "mean_train_time" in known
    if has_criterion:
        columns += _time_columns(row, adapts="mean_adaptation_time" in known)
    if "mean_steady_state" in known:
        spread = "steady_state_", "steady_state_standard_deviation"
        columns += _spread_columns("steady state", row, "mean_steady_state", *spread, 2)
    if not has_criterion:
        columns += _return_columns(row, known)
    if not has_sweep:
        seconds, steps = timings.get(row["arm"], (0.0, 0.0))
        pace = (f"{seconds:,.1f} s", short_count(steps / seconds)) if seconds else (_UNKNOWN, _UNKNOWN)
        columns += zip(("wall time", "steps/s"), pace, strict=True)
    return columns


def short_count(number: float) -> str:
    """In millions, smaller numbers in thousands or as they are.

    >>> short_count(12_345_678), short_count(2_600), short_count(49.6), short_count(0.42), short_count(0)
    ('12.3 M', '2.6 k', '50', '0.42', '0')
    """
    if number >= 1e5:
        return f"{number / 1e6:,.1f} M"
    if number >= 1e3:
        return f"{number / 1e3:,.1f} k"
    return f"{number:.0f}" if number >= 10 else f"{number:.2g}"


def _time_columns(row: Mapping[str, Any], *, adapts: bool) -> Columns:
    censored = _UNKNOWN if row["num_censored"] is None else f"{row['num_censored']} of {row['runs']}"
    if adapts:
        spread = "adaptation_time_", "adaptation_time_standard_deviation"
        columns = _spread_columns("adaptation time", row, "mean_adaptation_time", *spread, 0)
        return [*columns, ("censored", censored)]
    columns = _spread_columns("train time", row, "mean_train_time", "interval_", "standard_deviation", 0)
    middle = [("IQM", _number(row["interquartile_mean"], 0)), ("median", _number(row["median"], 0))]
    return [*columns, *middle, ("censored", censored)]


def _return_columns(row: Mapping[str, Any], known: set[str]) -> Columns:
    """Of results of older versions, which do not know it, the episodes."""
    if "mean_last_tenth_return" not in known:
        columns = [] if "mean_steady_state" in known else [("episodes", f"{row['episodes']:,}")]
    else:
        spread = "last_tenth_return_", "last_tenth_return_standard_deviation"
        columns = _spread_columns("return, last tenth", row, "mean_last_tenth_return", *spread, 2)
        if "mean_steady_state" in known:
            # Two spreads would not fit beside each other, and those of two means of one run's end say nearly the same.
            columns.pop()
        columns.append(("median", _number(row["median_last_tenth_return"], 2)))
    return [*columns, ("steps", short_count(row["steps"]))]


def _spread_columns(
    heading: str, row: Mapping[str, Any], mean: str, interval: str, deviation: str, digits: int
) -> Columns:
    """Mean, interval and standard deviation; the spread of a single run is not known."""
    ends = [_number(row[f"{interval}{end}"], digits) for end in ("low", "high")]
    is_known = row[mean] is not None and row[deviation] is not None and row["runs"] > 1
    return [
        (heading, _number(row[mean], digits)),
        ("95 % interval", " to ".join(ends) if is_known else _UNKNOWN),
        ("SD", _number(row[deviation] if is_known else None, digits)),
    ]


def _number(value: float | None, digits: int) -> str:
    return _UNKNOWN if value is None else f"{value:,.{digits}f}"
