"""What all runs say of the switch delays: one row per ensemble, and per pair of them, in episodes and in steps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from jobs.analysis.statistics.bootstrap import NUM_RESAMPLES, Estimate, Floats, bootstrap_curve, bootstrap_of_means
from jobs.analysis.switching.delay import ROUNDING, first_of_last_stretch
from jobs.analysis.switching.runs import SwitchData

_UNITS = {"episodes": "delay", "steps": "delay_steps"}
_BY_RUN, _BY_MEANS = "runs", "mean curves"


def switch_table(rows: Any, data: SwitchData | None = None) -> Any:
    """Median and mean delay of every ensemble with 95 % intervals, and what ensembles differ by, run by run.

    Parameters
    ----------
    rows:
        Of `SwitchData.rows`.
    data:
        Also gives the delay between the *mean* curves over the runs, in steps; see `delay_of_means`.

    Returns
    -------
    A data frame: ``arm``, ``sweep``; ``minus``, the arm that is subtracted in a pair, else empty; ``reading`` (``runs``
    or ``mean curves``), ``unit``; ``runs`` that count, those ``without_crossover``, which do not, and those
    ``censored``, which do with a lower bound; ``median`` and ``mean`` with ``…_low`` and ``…_high``. The reading of
    mean curves has one number, which stands as the mean.
    """
    found: list[dict[str, Any]] = []
    for sweep, group in rows.groupby("sweep", sort=False):
        arms = {str(arm): each.set_index("run_index") for arm, each in group.groupby("arm", sort=False)}
        for arm, each in arms.items():
            found += _rows(each, {"arm": arm, "sweep": sweep, "minus": ""})
            if data is not None:
                found.append(_row_of_means(data, arm, str(sweep)))
        for first, second in combinations(arms, 2):
            found += _rows(_difference(arms[second], arms[first]), {"arm": second, "sweep": sweep, "minus": first})
    return pd.DataFrame(found, columns=COLUMNS).astype(dict.fromkeys(_COUNTS, "Int64"))


def delay_of_means(
    steps: Floats, gaps: Floats, shares: Floats, *, num_resamples: int = NUM_RESAMPLES
) -> Estimate[float] | None:
    """From the last crossing of the mean curves to where the late learner's mean share comes to stay at one half.

    Both are read on a common grid of steps, and resampled together. Where one does not come about in a resample, the
    end of the grid stands for it.

    Parameters
    ----------
    steps:
        ``float64[points]``, rising.
    gaps, shares:
        ``float64[runs, points]``: late curve minus early curve; share of the late learner.
    num_resamples:
        How many are drawn.

    Returns
    -------
    In environment steps; None where the mean curves do not cross, or the mean share does not stay at one half.
    """
    is_never = [crossing_of_means(steps, gaps) is None, crossing_of_means(steps, shares - 0.5, strict=False) is None]
    if any(is_never):
        return None
    count = len(steps)

    def delay(means: Floats) -> Floats:
        crossing = _stays(means[..., :count] > ROUNDING, steps)
        return _stays(means[..., count:] >= 0.5, steps) - crossing

    return bootstrap_of_means(np.hstack((gaps, shares)), delay, num_resamples=num_resamples)


def crossing_of_means(steps: Floats, values: Floats, *, strict: bool = True) -> float | None:
    """First of ``steps`` from which on the mean of ``float64[runs, points]`` is above 0 (at least 0); None if never."""
    if not values.size:
        return None
    means = values.mean(axis=0)
    place = int(first_of_last_stretch(means > ROUNDING if strict else means >= 0))
    return float(steps[place]) if place < len(steps) else None


def _stays(holds: Any, steps: Floats) -> Floats:
    return steps[np.minimum(first_of_last_stretch(holds), len(steps) - 1)]


def _rows(each: Any, name: dict[str, Any]) -> Iterator[dict[str, Any]]:
    known = each[each["delay"].notna()]
    counts = {
        "runs": len(known),
        "without_crossover": len(each) - len(known),
        "censored": int(known["censored"].sum()),
    }
    for unit, column in _UNITS.items():
        row = {**name, "reading": _BY_RUN, "unit": unit, **counts}
        if len(known):
            values = known[column].to_numpy(np.float64)
            for location in ("median", "mean"):
                row |= _estimated(location, bootstrap_curve(values, "median" if location == "median" else "mean"))
        yield row


def _difference(later: Any, earlier: Any) -> Any:
    """Run by run, of the runs that both have."""
    common = later.index.intersection(earlier.index)
    later, earlier = later.loc[common], earlier.loc[common]
    difference = later[list(_UNITS.values())] - earlier[list(_UNITS.values())]
    return difference.assign(censored=later["censored"] | earlier["censored"])


def _row_of_means(data: SwitchData, arm: str, sweep: str) -> dict[str, Any]:
    steps, gaps, shares = data.gaps_and_shares((arm, sweep))
    found = delay_of_means(steps, gaps, shares)
    row = {"arm": arm, "sweep": sweep, "minus": "", "reading": _BY_MEANS, "unit": "steps", "runs": len(gaps)}
    return row | (_estimated("mean", found) if found else {})


def _estimated(name: str, estimate: Estimate[Any]) -> dict[str, float]:
    value, low, high = map(float, estimate)
    return {name: value, f"{name}_low": low, f"{name}_high": high}


_NUMBERS = [f"{location}{end}" for location in ("median", "mean") for end in ("", "_low", "_high")]
_COUNTS = ["runs", "without_crossover", "censored"]
COLUMNS = ["arm", "minus", "sweep", "reading", "unit", *_COUNTS, *_NUMBERS]
HEADINGS = ["delay of", "runs", "without crossover", "censored", "median", "95 % interval", "mean", "95 % interval"]


def cells(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Rows of the table as text, under `HEADINGS`; empty or missing values become a dash."""
    return [_cells({key: None if value in ("", None) else value for key, value in row.items()}) for row in rows]


def _cells(row: dict[str, Any]) -> list[str]:
    name = f"{row['arm']} − {row['minus']}" if row["minus"] else str(row["arm"])
    details = [row["sweep"] or "", "mean curves" if row["reading"] == _BY_MEANS else "", f"in {row['unit']}"]
    counts = [_number(row[column]) for column in _COUNTS]
    numbers = []
    for location in ("median", "mean"):
        low, high = row[f"{location}_low"], row[f"{location}_high"]
        numbers += [_number(row[location]), "-" if low is None else f"{_number(low)} to {_number(high)}"]
    return [", ".join([name, *filter(None, details)]), *counts, *numbers]


def _number(value: Any) -> str:
    return "-" if value is None else f"{float(value):,.0f}"
