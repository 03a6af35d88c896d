"""Episodes in which a learner learns nothing, such as those in which it takes the first of its best actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import BatchedEnvironment, Runs
from apel.experience.sight import Sight
from apel.learners.banks.batched_learner import BatchedLearner
from apel.learners.banks.learner_list import LearnerList

Choose = Callable[[Runs, NDArray[Any]], NDArray[Any]]
"""The actions of runs at what they see, ``[A, …]``, as banks have them (`apel.experience.action_form`)."""


def evaluate_greedily(
    learner: BatchedLearner, environment: BatchedEnvironment, sight: Sight, run: int, seed: int
) -> tuple[int, float]:
    """Length and return of an episode of ``run`` without exploring, in its environment reset with ``seed``.

    What a user's code raises is raised.
    """
    return play_unlearned(greedy_choice(learner), environment, sight, run, seed)


def greedy_choice(learner: BatchedLearner) -> Choose:
    """What it would do without exploring, such as the first of its best actions."""

    def choose(runs: Runs, seen: NDArray[Any]) -> NDArray[Any]:
        actions = greedy_actions(learner, runs, seen)
        raise_first(learner.errors)
        return actions

    return choose


def exploring_choice(learner: BatchedLearner) -> Choose:
    """What the learner does while it learns."""

    def choose(runs: Runs, seen: NDArray[Any]) -> NDArray[Any]:
        actions, _ = learner.act(runs, seen)
        raise_first(learner.errors)
        return actions

    return choose


def play_unlearned(
    choose: Choose, environment: BatchedEnvironment, sight: Sight, run: int, seed: int, max_steps: int | None = None
) -> tuple[int, float]:
    """Length and return of an episode, see `evaluate_greedily`; one that does not end is cut off at ``max_steps``."""
    runs = np.array([run], dtype=np.int64)
    stepped = environment.reset(runs, [seed])
    raise_first(stepped.errors)
    seen, length, total = sight.start(runs, environment.decode(stepped.entry)), 0, 0.0
    while True:
        stepped = environment.step(runs, choose(runs, seen))
        raise_first(stepped.errors)
        length += 1
        total += float(stepped.reward[0])
        if stepped.terminated[0] or stepped.truncated[0] or length == max_steps:
            return length, total
        seen = sight.push(runs, environment.decode(stepped.entry))


def greedy_actions(learner: BatchedLearner, runs: Runs, seen: NDArray[Any]) -> NDArray[Any]:
    """What the learners of ``runs`` would do without exploring: the first of their best actions, or what they say."""
    if isinstance(learner, LearnerList):
        return learner.greedy_actions(runs, seen)
    return learner.action_values(runs, seen).argmax(axis=1)


def raise_first(errors: Mapping[int, BaseException]) -> None:
    """Raise one of the errors, if there are any."""
    for error in errors.values():
        raise error
