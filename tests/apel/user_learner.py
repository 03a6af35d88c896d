"""Learners as users write them, found by import path: `tests.apel.user_learner:AverageReward`."""

from __future__ import annotations

import random
from typing import Any, ClassVar

import numpy as np

from apel.learners import Transition


class AverageReward:
    """Prefers the action with the best average reward so far, wherever it is; explores every ``explore_every`` steps.

    As little as a learner can be: it looks at no observation, and knows no probabilities.
    """

    off_policy: ClassVar[bool] = True

    def __init__(self, observation_space: Any, action_space: Any, seed: int, explore_every: int = 3) -> None:
        if explore_every < 1:
            message = f"explore_every: found {explore_every}, expected at least 1"
            raise ValueError(message)
        self._explore_every = explore_every
        self._random = random.Random(seed)
        self._num_actions = int(action_space.n)
        self._sum = [0.0] * self._num_actions
        self._count = [0] * self._num_actions
        self._acted = 0
        self.episodes = 0

    def act(self, observation: Any) -> tuple[int, None]:
        self._acted += 1
        if self._acted % self._explore_every == 0:
            return self._random.randrange(self._num_actions), None
        average = [total / max(count, 1) for total, count in zip(self._sum, self._count, strict=True)]
        return average.index(max(average)), None

    def learn(self, transition: Transition) -> None:
        self._sum[transition.action] += transition.reward
        self._count[transition.action] += 1

    def end_episode(self) -> None:
        self.episodes += 1

    def state(self) -> dict[str, Any]:
        version, words, gauss = self._random.getstate()
        return {
            "sum": list(self._sum),
            "count": list(self._count),
            "clocks": [self._acted, self.episodes],
            "random": [version, list(words), gauss],
        }

    def restore(self, state: dict[str, Any]) -> None:
        self._sum, self._count = list(state["sum"]), list(state["count"])
        self._acted, self.episodes = state["clocks"]
        version, words, gauss = state["random"]
        self._random.setstate((version, tuple(words), gauss))


class Opinionated(AverageReward):
    """One that says what it thinks of each action, and whose policy can be frozen: it may vote, and be evaluated."""

    def __init__(self, observation_space: Any, action_space: Any, seed: int, explore_every: int = 3) -> None:
        super().__init__(observation_space, action_space, seed, explore_every)
        self._frozen: list[float] | None = None

    def act(self, observation: Any) -> tuple[int, None]:
        self._acted += 1
        if self._acted % self._explore_every == 0:
            return self._random.randrange(self._num_actions), None
        return int(np.argmax(self.action_values(observation))), None

    def action_values(self, observation: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.array(self._averages() if self._frozen is None else self._frozen)

    def freeze(self) -> None:
        self._frozen = self._averages()

    def state(self) -> dict[str, Any]:
        return {**super().state(), "frozen": self._frozen}

    def restore(self, state: dict[str, Any]) -> None:
        super().restore(state)
        self._frozen = state["frozen"]

    def _averages(self) -> list[float]:
        return [total / max(count, 1) for total, count in zip(self._sum, self._count, strict=True)]


class Unfreezable(AverageReward):
    """Says what it thinks, always of today."""

    def action_values(self, observation: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.array(self._sum)


class Recorder(AverageReward):
    """Keeps what it was given, to be looked at."""

    def __init__(self, observation_space: Any, action_space: Any, seed: int) -> None:
        super().__init__(observation_space, action_space, seed)
        self.space, self.seed = observation_space, seed
        self.seen: list[Transition] = []

    def learn(self, transition: Transition) -> None:
        super().learn(transition)
        copies = [np.array(part) for part in (transition.observation, transition.next_observation)]
        self.seen.append(transition._replace(observation=copies[0], next_observation=copies[1]))


class Refusing(AverageReward):
    """Fails when it learns from its hundredth step."""

    def learn(self, transition: Transition) -> None:
        super().learn(transition)
        if sum(self._count) == 100:
            message = "a hundred is enough"
            raise ArithmeticError(message)


class OnPolicy(AverageReward):
    """Declares that it cannot learn from others."""

    off_policy: ClassVar[bool] = False


class NoLearner:
    """Has none of a learner's methods."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass


def not_a_number(trajectory: Any) -> float:
    """A performance measure that is none."""
    return float("nan")


def actions_taken(trajectory: Any) -> float:
    """A performance measure: how many different actions were taken, minus a little for every step."""
    return len(set(trajectory.action.tolist())) - 0.001 * len(trajectory)


NOT_CALLABLE = 3.5
