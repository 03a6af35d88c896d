"""Nanoseconds per episode and run of every selector: ``python -m benchmarks.selector_cost``.

One compiled loop over runs calls `select` and `observe` by their addresses, as a learner's host does, with normal
performances of different means. Written to benchmarks/results/.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.building.registry import SELECTORS
from apel.numerics.compiled import njit
from apel.numerics.seeding import Role, make_stream
from apel.numerics.views import Row
from apel.run.selection import Observe, Select, Selector
from jobs.results.manifest import versions

RUNS, EPISODES, NUM_LEARNERS = 100, 5_000, (2, 20)
WINDOWS = (1_000, 10_000, 100_000)


@njit
def play(
    select: Select, observe: Observe, parameters: Row, state: Row, streams: NDArray[np.uint64], noise: Row, n: int
) -> None:
    """Play all runs episode by episode, ``noise`` being ``float64[episodes]``; run by run within an episode."""
    for episode in range(noise.shape[0]):
        for run in range(state.shape[0]):
            selected = select(parameters, n, state[run], streams[run])
            observe(parameters, n, state[run], selected, noise[episode] + selected / n)


def nanoseconds(selector: Selector, num_learners: int, runs: int, episodes: int, repeats: int) -> float:
    """Median over repeats of the time per episode and run."""
    noise = np.random.default_rng(1).normal(size=episodes)
    times = []
    for repeat in range(repeats + 1):  # the first one compiles
        state = np.tile(selector.initial_state(num_learners, episodes), (runs, 1))
        streams = np.array([make_stream(seed, Role.SELECTOR) for seed in range(runs)])
        taken = noise if repeat else noise[:2]
        began = time.perf_counter()
        play(selector.select, selector.observe, selector.parameters(), state, streams, taken, num_learners)
        times.append((time.perf_counter() - began) / (runs * episodes) * 1e9)
    return statistics.median(times[1:])


def measure(repeats: int) -> dict[str, Any]:
    """Everything, as the record that is written."""
    cost = {
        name: {str(n): nanoseconds(SELECTORS[name](), n, RUNS, EPISODES, repeats) for n in NUM_LEARNERS}
        for name in SELECTORS
    }
    windows = {}
    for normalise in ("none", "minmax_window"):
        for window in WINDOWS:
            # The window must be full for most of the time: four times as many episodes, in a few runs.
            selector = SELECTORS["ssbas"](window=window, normalise=normalise)
            windows[f"{normalise}, {window}"] = nanoseconds(selector, 2, 5, 4 * window, repeats)
        selector = SELECTORS["ssbas"](normalise=normalise)
        for episodes in WINDOWS:
            windows[f"{normalise}, half of {episodes}"] = nanoseconds(selector, 2, 5, episodes, repeats)
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {"cores": os.cpu_count(), "processor": platform.processor() or platform.machine()},
        "versions": versions(),
        "runs": RUNS,
        "episodes": EPISODES,
        "repeats": repeats,
        "nanoseconds_per_episode_and_run": cost,
        "ssbas_nanoseconds_by_window": windows,
    }


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    record = measure(parser.parse_args().repeats)
    print(f"{'ns per episode and run':24s}" + "".join(f"{n:>6d} learners" for n in NUM_LEARNERS))
    for name, values in record["nanoseconds_per_episode_and_run"].items():
        print(f"{name:24s}" + "".join(f"{value:15.0f}" for value in values.values()))
    for name, value in record["ssbas_nanoseconds_by_window"].items():
        print(f"ssbas, {name:32s} {value:8.0f}")
    path = Path(__file__).parent / "results" / "selector_cost.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(record, indent=2) + "\n")
    print(path)


if __name__ == "__main__":
    main()
