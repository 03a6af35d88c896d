"""Environment steps with training per second, summed over runs: ``python -m benchmarks.stacked_dqn``.

DQN on CartPole with one update of 32 transitions per step, for 1, 8, 32 and 100 runs. The runs of this project are
split over as many processes as there are cores, each a stack of its share; stable-baselines3's DQN and code in one file
in the manner of CleanRL play one run per process and core, so that their sum does not depend on the number of runs from
two on. Each is measured from after the first updates on, all in one go and several times, and told as medians and
ratios. Written to benchmarks/results/.
"""

from __future__ import annotations

import argparse
import cProfile
import io
import json
import multiprocessing
import os
import platform
import pstats
import re
import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jobs.manifest import versions

CORES = os.cpu_count() or 1
RUNS = (1, 8, 32, 100)
NETWORKS: dict[str, dict[str, Any]] = {
    "64-64": {"dueling": False, "head_hidden": []},
    "64-64, dueling 256": {"dueling": True, "head_hidden": [256]},
}
COMMON: dict[str, Any] = {"network": {"activation": "relu", "initialisation": "pytorch"}, "learning_starts": 1_000}
EPISODES, WARM_UP = 10**6, 1_200
Span = tuple[float, float, int]
"""When a measurement began and ended, and the environment steps in it."""


def stack(seed: int, seconds: float, network: str, runs: int) -> Span:
    """A stack of runs in this process, as a learner's host plays it."""
    import torch

    from apel.book import open_book
    from apel.building import make_bank, make_performance, make_selector
    from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
    from apel.environments import make_world
    from apel.learners.base import StreakLimit
    from apel.seeding import run_seeds

    torch.set_num_threads(1)
    seeds = run_seeds(seed, runs)
    worlds = [make_world(EnvironmentConfig("apel/CartPole-v0"), one) for one in seeds]
    config = LearnerConfig("dqn", {**COMMON, **NETWORKS[network]})
    bank = make_bank([config] * runs, worlds, seeds, 0, make_performance("return"), with_probability=False)
    selector = make_selector(SelectorConfig("fixed"))
    book = open_book(selector, 1, EPISODES, None, seeds, [world.info for world in worlds])
    began, counted_from, everyone = 0.0, 0, range(runs)
    while not began or time.monotonic() - began < seconds:
        bank.play(everyone, book, selector, 0, StreakLimit(1_000, 200 * runs), record=False)
        if not began and book.steps.min() > WARM_UP:
            began, counted_from = time.monotonic(), int(book.steps.sum())
    return began, time.monotonic(), int(book.steps.sum()) - counted_from


def stable_baselines(seed: int, seconds: float, network: str, _: int) -> Span:
    """One run of stable-baselines3's DQN; it has no dueling network, the nearest is one more layer of 256."""
    import gymnasium
    import torch
    from stable_baselines3 import DQN
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)

    class Clock(BaseCallback):
        began, counted_from = 0.0, 0

        def _on_step(self) -> bool:
            if not self.began and self.num_timesteps >= WARM_UP:
                self.began, self.counted_from = time.monotonic(), self.num_timesteps
            return not self.began or time.monotonic() - self.began < seconds

    layers = [64, 64, *NETWORKS[network]["head_hidden"]]
    model = DQN(
        "MlpPolicy",
        gymnasium.make("CartPole-v1", max_episode_steps=200),
        learning_rate=5e-4,
        buffer_size=50_000,
        learning_starts=1_000,
        batch_size=32,
        gamma=1.0,
        train_freq=1,
        target_update_interval=500,
        exploration_final_eps=0.02,
        policy_kwargs={"net_arch": layers},
        seed=seed,
        device="cpu",
    )
    clock = Clock()
    model.learn(100_000, callback=clock)
    return clock.began, time.monotonic(), model.num_timesteps - clock.counted_from


def single_file(seed: int, seconds: float, network: str, _: int) -> Span:
    """One run of the code in one file."""
    from benchmarks.single_file_dqn import steps_per_second

    return steps_per_second(seed, seconds, dueling=NETWORKS[network]["dueling"])


def measured(
    play: Callable[[int, float, str, int], Span], network: str, shares: Sequence[int], seconds: float
) -> float:
    """Steps per second of several processes at once, summed."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(len(shares), mp_context=context) as pool:
        count = len(shares)
        spans = list(pool.map(play, range(1, count + 1), [seconds] * count, [network] * count, shares))
    return sum(steps / (ended - began) for began, ended, steps in spans)


def shares_of(runs: int) -> list[int]:
    """The runs of each process."""
    processes = min(runs, CORES)
    return [runs // processes + (i < runs % processes) for i in range(processes)]


def profile(network: str, runs: int, seconds: float) -> list[str]:
    """Where the time of one stack goes: the functions with most time of their own."""
    profiler = cProfile.Profile()
    profiler.enable()
    stack(1, seconds, network, runs)
    profiler.disable()
    text = io.StringIO()
    pstats.Stats(profiler, stream=text).sort_stats("tottime").print_stats(14)
    lines = [re.sub(r"/\S*/(site-packages/|(?=(apel|benchmarks)/))", "", line) for line in text.getvalue().splitlines()]
    return [line for line in lines if line.strip()][4:]


def measure(seconds: float, repeats: int) -> dict[str, Any]:
    """Everything, as the record that is written."""
    rates: dict[str, dict[str, list[float]]] = {network: {} for network in NETWORKS}
    for _ in range(repeats):
        for network, found in rates.items():
            for runs in RUNS:
                found.setdefault(f"stack of {runs}", []).append(measured(stack, network, shares_of(runs), seconds))
            for name, play in (("stable-baselines3", stable_baselines), ("single file", single_file)):
                found.setdefault(f"{name}, 1 process", []).append(measured(play, network, [1], seconds))
                found.setdefault(name, []).append(measured(play, network, [1] * CORES, seconds))
    medians = {
        network: {name: statistics.median(values) for name, values in found.items()} for network, found in rates.items()
    }
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {"cores": CORES, "processor": platform.processor() or platform.machine()},
        "versions": versions(),
        "seconds": seconds,
        "repeats": repeats,
        "steps_per_second": medians,
        "ratios": {network: ratios(found) for network, found in medians.items()},
        "profile": {network: profile(network, 32, seconds) for network in NETWORKS},
    }


def ratios(rates: dict[str, float]) -> dict[str, float]:
    """Each stack against both others; a single run against a single process of theirs."""
    found = {}
    for runs in RUNS:
        for other in ("stable-baselines3", "single file"):
            against = rates[f"{other}, 1 process"] if runs == 1 else rates[other]
            found[f"stack of {runs} / {other}"] = round(rates[f"stack of {runs}"] / against, 2)
    return found


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    record = measure(arguments.seconds, arguments.repeats)
    print(json.dumps({name: record[name] for name in ("steps_per_second", "ratios")}, indent=2))
    for network, lines in record["profile"].items():
        print(network, *lines, sep="\n")
    path = Path(__file__).parent / "results" / "stacked_dqn.json"
    path.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
