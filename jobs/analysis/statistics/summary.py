"""One row per arm and sweep point: what its runs say together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from jobs.analysis.statistics.bootstrap import Floats, bootstrap_curve, bootstrap_interval, interquartile_mean

# Further columns of the run rows that are summarised where they are known.
_LATE_RETURN = "last_tenth_return"
_MEASURES = ("adaptation_time", "steady_state", _LATE_RETURN)


def summarise(runs: pa.Table) -> pa.Table:
    """One row per arm and sweep point, in order of appearance: train times and their spread, other measures, work done.

    Of a run that is censored the train time is taken as it stands: see `jobs.results.caps.counted_with_cap`.

    A measure that no run has gives no columns; one that some arms lack is null for them.
    """
    frame = runs.to_pandas()
    known = [name for name in ("train_time", *_MEASURES) if name in frame and frame[name].notna().any()]
    rows = [
        _summary(str(arm), str(sweep), group, known)
        for (arm, sweep), group in frame.groupby(["arm", "sweep"], sort=False)
    ]
    return pa.Table.from_pylist(rows)


def _summary(arm: str, sweep: str, group: Any, known: list[str]) -> dict[str, Any]:
    row: dict[str, Any] = {
        "arm": arm,
        "sweep": sweep,
        "runs": len(group),
        "episodes": int(group["episodes"].sum()),
        "steps": int(group["steps"].sum()),
    }
    for name in known:
        values = group[name].dropna()
        numbers = values.to_numpy(dtype=np.float64)
        if name == "train_time":
            row |= _train_times(numbers, group.loc[values.index, "censored"])
        else:
            if name == _LATE_RETURN and len(values) < len(group):
                # Of runs that were met, or played by an older version, it is not known: the others say little alone.
                numbers = numbers[:0]
            mean, low, high, deviation = _spread(numbers)
            row |= {f"mean_{name}": mean, f"{name}_low": low, f"{name}_high": high}
            row[f"{name}_standard_deviation"] = deviation
            if name == _LATE_RETURN:
                row[f"median_{name}"] = float(np.median(numbers)) if len(numbers) else None
    return row


def _train_times(times: Floats, censored: Any) -> dict[str, float | int | None]:
    mean, low, high, deviation = _spread(times)
    middle = bootstrap_curve(times, "interquartile_mean") if len(times) else None
    return {
        "mean_train_time": mean,
        "interval_low": low,
        "interval_high": high,
        "standard_deviation": deviation,
        "interquartile_mean": interquartile_mean(times) if len(times) else None,
        "interquartile_mean_low": float(middle.low) if middle else None,
        "interquartile_mean_high": float(middle.high) if middle else None,
        "median": float(np.median(times)) if len(times) else None,
        "num_censored": int(censored.sum()) if len(times) else None,
    }


def _spread(values: Floats) -> tuple[float | None, float | None, float | None, float | None]:
    """Mean, the ends of its interval, and standard deviation; None without values, the deviation also of one alone.

    Of values that overflowed, as sums of huge returns do, the mean is no number either, and nothing else is known.
    """
    if not len(values):
        return None, None, None, None
    if not np.isfinite(values).all():
        return float(values.mean()), None, None, None
    deviation = float(values.std(ddof=1)) if len(values) > 1 else None
    return float(values.mean()), *bootstrap_interval(values), deviation
