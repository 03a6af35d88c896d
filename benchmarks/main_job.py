"""The main job side by side with its floor, and with what a user would write instead: ``make bench``.

Everything is measured in one run, several times, and told as medians and ratios. Written to benchmarks/results/.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import ray

from benchmarks import floor, plain_script
from cluster.launch import ray_cluster
from jobs.experiment.spec_files import load_experiment
from jobs.results.manifest import versions
from jobs.runner import Settings, run_experiment

CORES = os.cpu_count() or 1
PLAIN_EPISODES = {"Q_full": 60, "APEL": 60}


def median(function: Callable[[], float], repeats: int) -> float:
    """Median of several measurements."""
    return statistics.median(function() for _ in range(repeats))


def project(placement: str, runs: int, *overrides: str) -> float:
    """Seconds of the main job in a placement, from the plan to the last row; actors' start included, Ray's not."""
    experiment = load_experiment("distractor-maze", [f"runs={runs}", *overrides])
    with tempfile.TemporaryDirectory() as results:
        outcome = run_experiment(experiment, Settings(results=results, placement=placement))  # type: ignore[arg-type]
        assert not outcome.failures  # noqa: S101
        return outcome.seconds


def plain_seconds_per_step(arm: str) -> float:
    """Wall seconds per environment step of the plain script, with one process per core."""
    with ProcessPoolExecutor(CORES) as pool:
        list(pool.map(plain_script.play, range(CORES), [arm] * CORES, [1] * CORES))  # imports
        began = time.perf_counter()
        steps = sum(pool.map(plain_script.play, range(CORES), [arm] * CORES, [PLAIN_EPISODES[arm]] * CORES))
        return (time.perf_counter() - began) / steps


def fan_out_seconds_per_step(arm: str) -> float:
    """The same script, one Ray task per run."""
    task: Any = ray.remote(plain_script.play)
    ray.get([task.remote(seed, arm, 1) for seed in range(CORES)])
    began = time.perf_counter()
    steps = sum(ray.get([task.remote(seed, arm, PLAIN_EPISODES[arm]) for seed in range(CORES)]))
    return (time.perf_counter() - began) / steps


def measure(runs: int, repeats: int) -> dict[str, Any]:
    """Everything, as the record that is written."""
    plain = {arm: median(lambda arm=arm: plain_seconds_per_step(arm), repeats) for arm in PLAIN_EPISODES}
    floors = []
    seconds: dict[str, list[float]] = {"packed": [], "actors": []}
    began = time.perf_counter()
    with ray_cluster(num_cpus=CORES, dashboard=False):
        ray_start = time.perf_counter() - began
        project("packed", 2, "episodes=20")
        for _ in range(repeats):  # in turn, since machines have better and worse minutes
            floors.append(floor.measure(runs, CORES))
            for placement, values in seconds.items():
                values.append(project(placement, runs))
        empty = median(lambda: project("actors", 100, "episodes=1", "arms={Q_full: {learners: [Q_full]}}"), repeats)
        fan_out = {arm: median(lambda arm=arm: fan_out_seconds_per_step(arm), repeats) for arm in PLAIN_EPISODES}
    seconds = {"floor": [wall for wall, _, _ in floors], **seconds, "local (one core)": [project("local", runs)]}
    floor_seconds = statistics.median(seconds["floor"])
    steps = floors[0][2]
    per_step = {arm: statistics.median(times[arm] for _, times, _ in floors) / steps[arm] for arm in steps}
    slower = {
        arm: {
            "plain script": plain[arm] / per_step[arm] * CORES,
            "one Ray task per run": fan_out[arm] / per_step[arm] * CORES,
        }
        for arm in PLAIN_EPISODES
    }
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {"cores": CORES, "processor": platform.processor() or platform.machine()},
        "versions": versions(),
        "runs": runs,
        "repeats": repeats,
        "steps": steps,
        "seconds": seconds,
        "times_floor": {name: statistics.median(values) / floor_seconds for name, values in seconds.items()},
        "floor_nanoseconds_per_step_and_core": {arm: value * 1e9 for arm, value in per_step.items()},
        "plain_microseconds_per_step": {arm: value * 1e6 for arm, value in plain.items()},
        "ray_task_per_run_microseconds_per_step": {arm: value * 1e6 for arm, value in fan_out.items()},
        "slower_than_floor_per_step": slower,
        "nothing_milliseconds_per_run": empty / 100 * 1e3,
        "ray_start_seconds": ray_start,
    }


def show(record: dict[str, Any]) -> None:
    """Print a record."""
    print(f"{'main job':18s} {'seconds':>8s} {'x floor':>8s}")
    for name, values in record["seconds"].items():
        spread = ", ".join(f"{value:.1f}" for value in values)
        print(f"{name:18s} {statistics.median(values):8.1f} {record['times_floor'][name]:8.2f}   ({spread})")
    for arm, nanoseconds in record["floor_nanoseconds_per_step_and_core"].items():
        print(f"floor, {arm:8s} {nanoseconds:6.1f} ns per environment step and core")
    for arm, ratios in record["slower_than_floor_per_step"].items():
        for name, ratio in ratios.items():
            print(f"{arm}: {name}: {ratio:.0f} x the floor's time per step")
    nothing, start = record["nothing_milliseconds_per_run"], record["ray_start_seconds"]
    print(f"nothing, 100 runs: {nothing:.1f} ms per run beyond Ray's start ({start:.1f} s)")


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    record = measure(arguments.runs, arguments.repeats)
    show(record)
    path = Path(__file__).parent / "results" / "main_job.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(record, indent=2) + "\n")
    print(path)


if __name__ == "__main__":
    main()
