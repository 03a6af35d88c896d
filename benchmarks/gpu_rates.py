"""Environment steps with training per second, of some runs of DQN: ``python -m benchmarks.gpu_rates DEVICE SECONDS``.

A part of `benchmarks.gpu`. By the clock, since a GPU's work is none of the processor's time; this process has one core.
Runs are played side by side, as a learner's host does, with as many lanes as there are runs. One line of JSON each.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from apel.building import make_bank, make_performance, make_selector
from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
from apel.environments import make_world
from apel.experience.representations import Representation
from apel.learners.base import StreakLimit
from apel.numerics.seeding import run_seeds
from apel.run.opening import open_book

EXPERIMENTS = Path(__file__).resolve().parents[1] / "jobs" / "experiments"
PYTORCH = {"activation": "relu", "initialisation": "pytorch"}
RUNS = (1, 10, 32, 128)
STARTS, FOREVER = 100, 10**9
NOT_OPTIONS = ("type", "representation", "device", "num_gpus")


def shipped(name: str) -> dict[str, Any]:
    """The options of the DQN of an experiment that comes with this project."""
    learner = yaml.safe_load((EXPERIMENTS / name / "experiment.yaml").read_text())["learners"]["DQN"]
    return {key: value for key, value in learner.items() if key not in NOT_OPTIONS}


def subjects() -> dict[str, tuple[str, Representation, dict[str, Any]]]:
    """Environment, view and options, by name."""
    plain = {"network": PYTORCH, "dueling": False, "head_hidden": []}
    return {
        "MinAtar": ("apel/MinAtarBreakout-v0", Representation(channel="symbols"), shipped("deep/breakout-minatar")),
        "CartPole, 64-64": ("apel/CartPole-v0", Representation(), plain),
        "CartPole, dueling 256": ("apel/CartPole-v0", Representation(), {"network": PYTORCH}),
    }


def rate(subject: str, device: str, count: int, seconds: float) -> dict[str, float]:
    """Steps per second from after the first updates on, for so long or for one streak."""
    environment, view, options = subjects()[subject]
    began = time.perf_counter()
    seeds = run_seeds(1, count)
    worlds = [make_world(EnvironmentConfig(environment), one) for one in seeds]
    options |= {"learning_starts": STARTS, "replay_size": 10_000, "device": device, "lanes": count}
    configs = [LearnerConfig("dqn", options, view)] * count
    bank = make_bank(configs, worlds, seeds, 0, make_performance("return"), with_probability=False)
    selector = make_selector(SelectorConfig("fixed"))
    book = open_book(selector, 1, FOREVER, None, seeds, [world.info for world in worlds])

    def play(steps: int) -> None:
        bank.play(range(count), book, selector, 0, StreakLimit(1_000, steps * count), record=False)

    while book.steps.min() < 2 * STARTS:
        play(STARTS)
    ready, done = time.perf_counter(), int(book.steps.sum())
    while time.perf_counter() - ready < seconds:
        play(STARTS)
    taken, steps = time.perf_counter() - ready, int(book.steps.sum()) - done
    return {"steps_per_second": steps / taken, "steps": steps, "seconds": taken, "seconds_before": ready - began}


def measured(device: str, seconds: float) -> Iterator[dict[str, Any]]:
    """All cases that fit into the time, those of middle size first."""
    until = time.perf_counter() + seconds
    cases = [(subject, count) for count in sorted(RUNS, key=lambda one: one != 32) for subject in subjects()]
    for i, (subject, count) in enumerate(cases):
        label = {"part": "rate", "subject": subject, "runs": count, "device": device}
        left = until - time.perf_counter()
        if left < 1.0:
            yield {**label, "error": "no time left"}
            continue
        try:
            yield {**label, **rate(subject, device, count, min(0.5 * left / (len(cases) - i), 4.0))}
        except Exception as error:  # noqa: BLE001 - the others are still worth measuring
            yield {**label, "error": repr(error)}


if __name__ == "__main__":
    for found in measured(sys.argv[1], float(sys.argv[2])):
        print(json.dumps(found), flush=True)
