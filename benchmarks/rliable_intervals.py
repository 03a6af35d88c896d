"""Intervals by rliable, for benchmarks/statistics.py: run by an interpreter that has rliable.

Reads ``curves.npy``, ``float64[arms, runs, points]``, and ``scores.npy``, ``float64[arms, runs]``, from the folder
named first; writes ``theirs.npz`` and ``theirs.json`` there. The second argument is the confidence of percentile
intervals, the others are numbers of resamples.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rliable import library, metrics
from scipy import stats


def iqm_of_frames(scores: Any) -> Any:
    """As rliable's README does it: one call per point."""
    return np.array([metrics.aggregate_iqm(scores[..., frame]) for frame in range(scores.shape[-1])])


def iqm_at_once(scores: Any) -> Any:
    """The same of ``float64[runs, 1, points]`` in one call."""
    return stats.trim_mean(scores, 0.25, axis=0)[0]


def improvement(first: Any, second: Any) -> Any:
    return np.array([metrics.probability_of_improvement(first, second)])


def timed(scores: dict[str, Any], function: Callable[..., Any], reps: int, size: float) -> tuple[float, Any]:
    """Processor seconds, and ``float64[3, …, columns]``: value, low, high of each entry."""
    began = time.process_time()
    points, intervals = library.get_interval_estimates(scores, function, reps=reps, confidence_interval_size=size)
    seconds = time.process_time() - began
    return seconds, np.stack([np.stack([points[key], *intervals[key]]) for key in scores], axis=1)


def main() -> None:
    """Time rliable on the curves and scores of a folder, and write what it found beside them."""
    folder, size, counts = Path(sys.argv[1]), float(sys.argv[2]), [int(argument) for argument in sys.argv[3:]]
    curves, scores = np.load(folder / "curves.npy"), np.load(folder / "scores.npy")
    np.random.seed(0)  # noqa: NPY002 - rliable draws from the global generator
    by_arm = {str(arm): curve[:, None, :] for arm, curve in enumerate(curves)}
    pairs = {str(arm): [scores[0][:, None], scores[arm][:, None]] for arm in range(1, len(scores))}
    seconds: dict[str, float] = {}
    found: dict[str, Any] = {}
    tasks = [(f"interquartile_mean_per_point_{counts[0]}", by_arm, iqm_of_frames, counts[0])]
    for count in counts:
        tasks += [
            (f"mean_{count}", by_arm, metrics.aggregate_mean, count),
            (f"interquartile_mean_{count}", by_arm, iqm_at_once, count),
            (f"probability_{count}", pairs, improvement, count),
        ]
    for name, given, function, count in tasks:
        seconds[name], found[name] = timed(given, function, count, size)
    np.savez(folder / "theirs.npz", **found)
    versions = {name: version(name) for name in ("rliable", "arch", "numpy", "pandas", "scipy")}
    (folder / "theirs.json").write_text(json.dumps({"versions": versions, "processor_seconds": seconds}))


if __name__ == "__main__":
    main()
