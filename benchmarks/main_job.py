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
from jobs.manifest import _versions
from jobs.runner import Settings, run_experiment
from jobs.spec import load_experiment

CORES = os.cpu_count() or 1
PLAIN_EPISODES = {"Q_full": 60, "APEL": 60}


def median(function: Callable[[], float], repeats: int) -> tuple[float, list[float]]:
    """Median and all values."""
    values = [function() for _ in range(repeats)]
    return statistics.median(values), values


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


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    runs, repeats = arguments.runs, arguments.repeats

    plain = {arm: median(lambda arm=arm: plain_seconds_per_step(arm), repeats)[0] for arm in PLAIN_EPISODES}
    rows: dict[str, Any] = {}
    began = time.perf_counter()
    with ray_cluster(num_cpus=CORES, dashboard=False):
        ray_start = time.perf_counter() - began
        project("packed", 2, "episodes=20")
        floors = []
        values: dict[str, list[float]] = {"packed": [], "actors": []}
        for _ in range(repeats):  # in turn, since machines have better and worse minutes
            floors.append(floor.measure(runs, CORES))
            for placement, seconds in values.items():
                seconds.append(project(placement, runs))
        rows |= {placement: (statistics.median(seconds), seconds) for placement, seconds in values.items()}
        empty = median(lambda: project("actors", 100, "episodes=1", "arms={Q_full: {learners: [Q_full]}}"), repeats)
        fan_out = {arm: median(lambda arm=arm: fan_out_seconds_per_step(arm), repeats)[0] for arm in PLAIN_EPISODES}
    rows["local (one core)"] = median(lambda: project("local", runs), 1)

    floor_seconds = statistics.median(wall for wall, _, _ in floors)
    steps = floors[0][2]
    per_step = {arm: statistics.median(times[arm] for _, times, _ in floors) / steps[arm] for arm in steps}
    print(f"floor, {CORES} processes: {floor_seconds:.1f} s for {sum(steps.values()) / 1e6:.0f} M steps")
    for arm, seconds in per_step.items():
        print(f"  {arm:8s} {seconds * 1e9:6.1f} ns per environment step and core")
    print(f"{'main job':28s} {'seconds':>8s} {'x floor':>8s}")
    for name, (seconds, times) in {"floor": (floor_seconds, [f[0] for f in floors]), **rows}.items():
        spread = ", ".join(f"{value:.1f}" for value in times)
        print(f"{name:28s} {seconds:8.1f} {seconds / floor_seconds:8.2f}   ({spread})")
    packed_per_step = rows["packed"][0] / sum(steps.values())
    ratios = {}
    for arm in PLAIN_EPISODES:
        ours = per_step[arm] / CORES
        ratios[arm] = {"plain": plain[arm] / ours, "ray task per run": fan_out[arm] / ours}
        print(
            f"{arm}: plain script {plain[arm] * 1e6:.2f} µs per step ({ratios[arm]['plain']:.0f} x the floor), "
            f"one Ray task per run {fan_out[arm] * 1e6:.2f} µs ({ratios[arm]['ray task per run']:.0f} x)"
        )
    print(f"packed, whole job: {packed_per_step * 1e9:.1f} ns of wall time per step")
    print(f"nothing, 100 runs: {empty[0] / 100 * 1e3:.1f} ms per run beyond Ray's start ({ray_start:.1f} s)")

    record = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {"cores": CORES, "processor": platform.processor() or platform.machine()},
        "versions": _versions(),
        "runs": runs,
        "repeats": repeats,
        "floor_seconds": [f[0] for f in floors],
        "floor_nanoseconds_per_step_and_core": {arm: seconds * 1e9 for arm, seconds in per_step.items()},
        "steps": steps,
        "seconds": {name: values for name, (_, values) in rows.items()},
        "times_floor": {name: seconds / floor_seconds for name, (seconds, _) in rows.items()},
        "plain_microseconds_per_step": {arm: seconds * 1e6 for arm, seconds in plain.items()},
        "ray_task_per_run_microseconds_per_step": {arm: seconds * 1e6 for arm, seconds in fan_out.items()},
        "slower_than_floor_per_step": ratios,
        "nothing_milliseconds_per_run": empty[0] / 100 * 1e3,
        "ray_start_seconds": ray_start,
    }
    path = Path(__file__).parent / "results" / "main_job.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(record, indent=2) + "\n")
    print(path)


if __name__ == "__main__":
    main()
