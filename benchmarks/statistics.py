"""The statistics side by side with rliable: the same learning curves, times and intervals of both.

``python -m benchmarks.statistics --rliable PYTHON`` names an interpreter that has rliable; without it only ours is
measured. Written to benchmarks/results/.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from apel.numerics.intervals import expanded_levels
from jobs.analysis.statistics.bootstrap import Location, bootstrap_curve
from jobs.analysis.statistics.comparison import probability_of_improvement
from jobs.results.manifest import versions

ARMS, RUNS, POINTS = 4, 100, 100
COUNTS = (2_000, 10_000)
LOCATIONS: tuple[Location, ...] = ("mean", "interquartile_mean")
LOW, HIGH = expanded_levels(RUNS)
"""The percentiles of both sides: rliable has no expanded intervals, but it has confidences other than 95 %."""
# Of a percentile's end: √(p (1 − p)) / φ(1.99) of the resampled statistic's deviation, for each of √resamples.
END_ERROR = float(np.sqrt(LOW * HIGH) / stats.norm.pdf(stats.norm.ppf(HIGH)))


def synthetic_curves() -> NDArray[np.float64]:
    """Returns that rise from −300 to −20, faster in later arms, each at its pace; ``float64[arms, runs, points]``."""
    random = np.random.default_rng(20_211_206)
    pace = np.array([30.0, 25.0, 20.0, 15.0])[:, None, None] * random.lognormal(0, 0.6, (ARMS, RUNS, 1))
    noise = random.normal(0, 8, (ARMS, RUNS, POINTS))
    return -20 - 280 * np.exp(-np.arange(POINTS) / pace) + noise


def ours(name: str, data: dict[str, NDArray[np.float64]], count: int, seed: int = 0) -> NDArray[np.float64]:
    """``float64[3, entries, columns]``: value, low, high."""
    if name == "probability":
        first, *others = data["scores"]
        estimates: list[Any] = [
            probability_of_improvement(first, other, smaller_is_better=False, num_resamples=count, seed=seed)
            for other in others
        ]
        return np.stack([np.reshape(estimate, (3, 1)) for estimate in estimates], axis=1)
    location: Any = name
    estimates = [bootstrap_curve(curve, location, num_resamples=count, seed=seed) for curve in data["curves"]]
    return np.stack([np.stack(estimate) for estimate in estimates], axis=1)


def plain_scipy(data: dict[str, NDArray[np.float64]], count: int) -> None:
    """The interquartile mean by scipy.stats.bootstrap and scipy.stats.trim_mean as they come."""
    for curve in data["curves"]:
        stats.bootstrap(
            (curve,),
            lambda values, axis: stats.trim_mean(values, 0.25, axis=axis),
            n_resamples=count,
            batch=100,
            confidence_level=HIGH - LOW,
            method="percentile",
            rng=np.random.default_rng(0),
        )


def seconds_of(function: Callable[[], object], repeats: int) -> float:
    """Median processor time of several measurements: all of this is single-threaded, and neighbours do not count."""
    measured = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        measured.append(time.process_time() - began)
    return statistics.median(measured)


def distance(one: NDArray[np.float64], other: NDArray[np.float64], count: int) -> dict[str, float]:
    """Largest difference of values, and of interval ends in three units."""
    difference, width = np.abs(one[1:] - other[1:]), other[2] - other[1]
    error = np.sqrt(2 / count) * END_ERROR * width / (2 * stats.norm.ppf(HIGH))
    return {
        "largest_difference_of_values": float(np.max(np.abs(one[0] - other[0]))),
        "largest_difference_of_ends": float(np.max(difference)),
        "in_interval_widths": float(np.max(difference / width)),
        "in_monte_carlo_errors": float(np.max(difference / error)),
    }


def run_theirs(python: str, data: dict[str, NDArray[np.float64]]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Versions and seconds, and the intervals."""
    script = Path(__file__).with_name("rliable_intervals.py")
    with tempfile.TemporaryDirectory() as folder:
        for name, values in data.items():
            np.save(Path(folder, f"{name}.npy"), values)
        # Isolated, so that this file does not stand in for the standard library's module of its name.
        subprocess.run([python, "-I", str(script), folder, str(HIGH - LOW), *map(str, COUNTS)], check=True)
        with np.load(Path(folder, "theirs.npz")) as found:
            return json.loads(Path(folder, "theirs.json").read_text()), dict(found)


def measure(repeats: int, python: str | None) -> dict[str, Any]:
    """Everything in one run."""
    curves = synthetic_curves()
    data = {"curves": curves, "scores": np.round(curves[..., -1])}
    cases = [(name, count) for count in COUNTS for name in (*LOCATIONS, "probability")]
    found: dict[str, Any] = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {"cores": os.cpu_count(), "processor": platform.machine()},
        "versions": {name: versions()[name] for name in ("apel", "numpy", "scipy")},
        "data": {
            "shape": [ARMS, RUNS, POINTS],
            "sha256": hashlib.sha256(np.ascontiguousarray(curves).tobytes()).hexdigest(),
        },
        "repeats": repeats,
        "processor_seconds": {
            f"{name}_{count}": seconds_of(lambda name=name, count=count: ours(name, data, count), repeats)  # type: ignore[misc]
            for name, count in cases
        },
        "processor_seconds_scipy_trim_mean": {
            str(count): seconds_of(lambda count=count: plain_scipy(data, count), 1)  # type: ignore[misc]
            for count in COUNTS
        },
        "ours_with_another_seed": {
            f"{name}_{count}": distance(ours(name, data, count, 1), ours(name, data, count), count)
            for name, count in cases
        },
    }
    if python:
        about, theirs = run_theirs(python, data)
        found["rliable"] = about
        found["ours_against_rliable"] = {
            f"{name}_{count}": distance(theirs[f"{name}_{count}"], ours(name, data, count), count)
            for name, count in cases
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--rliable", metavar="PYTHON", help="an interpreter that has rliable")
    options = parser.parse_args()
    found = measure(options.repeats, options.rliable)
    target = Path(__file__).with_name("results") / "statistics.json"
    target.write_text(json.dumps(found, indent=2) + "\n")
    print(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
