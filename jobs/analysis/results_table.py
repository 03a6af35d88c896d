"""The table of results in words: the same for the terminal, the experiment's page and the reproduction's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

Timings = Mapping[str, tuple[float, float]]
"""Seconds and steps by arm."""


@dataclass(frozen=True)
class ResultsTable:
    """Headings and rows of text; ``num_names`` of the columns, counted from the left, are names and not numbers."""

    headings: list[str]
    rows: list[list[str]]
    num_names: int


def results_table(summary: pa.Table, timings: Timings) -> ResultsTable:
    """One row per arm and sweep point, with the measures that the experiment has.

    The wall time is known by arm, so it is left out where an arm has several rows.
    """
    rows = summary.to_pylist()
    names, columns = ["arm"], set(summary.column_names)
    if has_sweep := any(row["sweep"] for row in rows):
        names.append("sweep")
    headings = [*names, "runs"]
    adapts = "mean_adaptation_time" in columns
    if "mean_train_time" in columns:
        headings += ["adaptation time" if adapts else "train time", "95 % interval", "SD"]
        headings += ["censored"] if adapts else ["IQM", "median", "censored"]
    if "mean_steady_state" in columns:
        headings += ["steady state", "95 % interval", "SD"]
    if not columns & {"mean_train_time", "mean_steady_state"}:
        headings.append("episodes")
    headings += [] if has_sweep else ["wall time", "steps/s"]
    return ResultsTable(headings, [_cells(row, columns, has_sweep, timings) for row in rows], len(names))


def _cells(row: Mapping[str, Any], columns: set[str], has_sweep: bool, timings: Timings) -> list[str]:
    cells = [row["arm"], *([row["sweep"]] if has_sweep else []), str(row["runs"])]
    if "mean_train_time" in columns:
        cells += _time_cells(row, adapts="mean_adaptation_time" in columns)
    if "mean_steady_state" in columns:
        cells += _spread_cells(row, "mean_steady_state", "steady_state_", "steady_state_standard_deviation", 2)
    if not columns & {"mean_train_time", "mean_steady_state"}:
        cells.append(f"{row['episodes']:,}")
    if not has_sweep:
        seconds, steps = timings.get(row["arm"], (0.0, 0.0))
        cells += [f"{seconds:,.1f} s", short_count(steps / seconds)] if seconds else ["-", "-"]
    return cells


def short_count(number: float) -> str:
    """In millions, small numbers in thousands.

    >>> short_count(12_345_678), short_count(2_600), short_count(0)
    ('12.3 M', '2.6 k', '0.0 M')
    """
    return f"{number / 1e3:,.1f} k" if 0 < number < 1e5 else f"{number / 1e6:,.1f} M"


def _time_cells(row: Mapping[str, Any], *, adapts: bool) -> list[str]:
    censored = "-" if row["num_censored"] is None else f"{row['num_censored']} of {row['runs']}"
    if adapts:
        deviation = "adaptation_time_standard_deviation"
        return [*_spread_cells(row, "mean_adaptation_time", "adaptation_time_", deviation, 0), censored]
    cells = _spread_cells(row, "mean_train_time", "interval_", "standard_deviation", 0)
    middle = [f"{row[name]:,.0f}" if row[name] is not None else "-" for name in ("interquartile_mean", "median")]
    return [*cells, *middle, censored]


def _spread_cells(row: Mapping[str, Any], mean: str, interval: str, deviation: str, digits: int) -> list[str]:
    if row[mean] is None:
        return ["-"] * 3
    low, high = row[f"{interval}low"], row[f"{interval}high"]
    return [f"{row[mean]:,.{digits}f}", f"{low:,.{digits}f} to {high:,.{digits}f}", f"{row[deviation]:,.{digits}f}"]
