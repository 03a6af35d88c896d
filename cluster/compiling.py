"""Compiling what a job will need before any worker starts, so that no two of them compile the same."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from apel.building import make_bank, make_selector
from apel.building.registry import SELECTORS
from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
from apel.environments import make_world
from apel.learners import LockstepBank
from apel.learners.base import StreakLimit
from apel.numerics.compiled import is_compiled, mark_compiled
from apel.run.opening import open_book
from cluster.coordinator import Coordinator
from cluster.local import LocalHosts
from cluster.shard import ArmPlan, Execution, RunPlan, Shard

DEEP_LEARNERS = ("acer", "dqn", "sac")
"""Those with compiled functions of their own."""
_MAZE = EnvironmentConfig("apel/Maze-v0", {"size": 3, "distractors": [2], "max_steps": 20})
_CART_POLE = EnvironmentConfig("apel/CartPole-v0", {"max_steps": 20})
_SMALL = {"network": {"hidden": [8]}, "learning_starts": 1}


def not_compiled(names: Collection[str]) -> list[str]:
    """Those of the shipped selectors and learners among ``names`` whose compiled functions are not in the cache yet."""
    return [name for name in sorted(names) if (name in SELECTORS or name in DEEP_LEARNERS) and not is_compiled(name)]


def compile_for(names: Collection[str]) -> None:
    """Play a few episodes with each of some shipped selectors and learners, so that no worker has to compile what it
    needs.

    Compiling takes some twenty seconds, once per installation, and one for each selector; for each deep learner as long
    again, in a process beside this one. Without this, all workers would do the same at once.
    """
    missing = not_compiled(names)
    deep = [name for name in missing if name in DEEP_LEARNERS]
    with ThreadPoolExecutor(os.cpu_count() or 1) as beside:
        started = [beside.submit(_compile_beside, name) for name in deep]
        for name in missing:
            if name in SELECTORS:
                _compile_selector(name)
                mark_compiled(name)
        for one in started:
            one.result()
    for name in deep:
        if not is_compiled(name):  # what went wrong beside is seen here
            compile_learner(name)


def compile_learner(name: str) -> None:
    """Compile what a deep learner needs: to act and learn, step by step, and whole episodes of our environments."""
    for environment in (_CART_POLE, _MAZE):
        world = make_world(environment, 1)
        bank = make_bank([LearnerConfig(name, _SMALL)], [world], [1], 0, "return", with_probability=True)
        assert isinstance(bank, LockstepBank)  # noqa: S101 - they are no tables
        selector = make_selector(SelectorConfig("fixed"))
        book = open_book(selector, 1, 4, None, [1], [world.info])
        played = bank.play([0], book, selector, 0, StreakLimit(4, 1_000), record=True)
        if played.batch is not None:
            bank.learn(played.batch)
            run = np.zeros(1, dtype=np.int64)
            bank.learner.act(run, bank.first_seen(run, played.batch.observation[:1]))
        bank.evaluate_one(0, 0)
    mark_compiled(name)


def _compile_beside(name: str) -> None:
    """In a process of its own: what it has compiled is found in the cache."""
    code = f"from cluster.compiling import compile_learner; compile_learner({name!r})"
    root = str(Path(__file__).resolve().parents[1])
    path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    subprocess.run(
        [sys.executable, "-P", "-c", code],
        env={**os.environ, "PYTHONPATH": path},
        check=False,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def _compile_selector(name: str) -> None:
    for num_learners in (1, 2):
        run = RunPlan(0, 0, _MAZE, (LearnerConfig("q_learning"),) * num_learners)
        names = tuple(f"learner {i}" for i in range(num_learners))
        arm = ArmPlan("compile", name, "", names, SelectorConfig(name), "return", 5, recording="all")
        coordinator = Coordinator(LocalHosts(), Nowhere(), Nowhere(), Execution(streak_episodes=2))
        for _ in coordinator.run(Shard(arm, (run,))):
            pass


class Nowhere:
    """A sink and a store of checkpoints that keep nothing."""

    def spill(self, *_: Any) -> str:
        """Keep nothing."""
        return ""

    def commit(self, *_: Any) -> None:
        """Keep nothing."""

    def keep(self, *_: Any) -> None:
        """Keep nothing."""

    def read(self, _: Shard) -> None:
        """There is nothing."""

    def write(self, *_: Any) -> None:
        """Keep nothing."""

    def delete(self, _: Shard) -> None:
        """There is nothing."""
