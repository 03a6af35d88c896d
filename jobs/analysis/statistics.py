"""What a hundred runs say: location, spread and intervals, from the run rows alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from scipy import stats

_RESAMPLES = 10_000
_CONFIDENCE = 0.95


def interquartile_mean(values: NDArray[np.float64]) -> float:
    """Mean of the middle half, ``float64[runs]`` (Agarwal et al. 2021, *Deep RL at the edge of the statistical
    precipice*).

    >>> interquartile_mean(np.array([0.0, 1.0, 3.0, 100.0]))
    2.0
    """
    return float(stats.trim_mean(values, 0.25))


def bootstrap_interval(values: NDArray[np.float64]) -> tuple[float, float]:
    """95 % percentile bootstrap interval of the mean of ``float64[runs]``; a point where all are equal."""
    if len(values) < 2 or np.all(values == values[0]):
        return float(values[0]), float(values[0])
    interval = stats.bootstrap(
        (values,),
        np.mean,
        n_resamples=_RESAMPLES,
        confidence_level=_CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def summarise(runs: pa.Table) -> pa.Table:
    """One row per arm and sweep point, in order of appearance: train times and their spread, work done."""
    frame = runs.to_pandas()
    rows = [
        _summary(str(arm), str(sweep), group) for (arm, sweep), group in frame.groupby(["arm", "sweep"], sort=False)
    ]
    return pa.Table.from_pylist(rows)


def _summary(arm: str, sweep: str, group: Any) -> dict[str, Any]:
    row: dict[str, Any] = {
        "arm": arm,
        "sweep": sweep,
        "runs": len(group),
        "episodes": int(group["episodes"].sum()),
        "steps": int(group["steps"].sum()),
    }
    times = group["train_time"].dropna().to_numpy(dtype=np.float64)
    if len(times):
        low, high = bootstrap_interval(times)
        row |= {
            "mean_train_time": float(times.mean()),
            "interval_low": low,
            "interval_high": high,
            "standard_deviation": float(times.std(ddof=1)) if len(times) > 1 else 0.0,
            "interquartile_mean": interquartile_mean(times),
            "median": float(np.median(times)),
            "num_censored": int(group["censored"].sum()),
        }
    return row
