"""Dyna-Q (Sutton 1990; Sutton & Barto 2018, §8.2): Q-learning that also learns a model, and plans with it.

The model-based learner that chapter 1 pairs with model-free ones. The compiled bank of the same algorithm is
`apel.learners.banks.compiled`.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.learners.base import State, Transition
from apel.learners.tabular.q_learning import (
    OPTIONS_CONFIG,
    QLearning,
    QLearningOptions,
    observation_key,
    packed_keys,
    unpacked_keys,
)
from apel.numerics.streams import integer

_Outcome = tuple[float, tuple[int, ...] | None]
"""Reward, and the next state unless the episode terminated."""


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class DynaQOptions(QLearningOptions):
    """Options of Dyna-Q: those of Q-learning, and one more.

    Attributes
    ----------
    planning_steps:
        Updates from the model after every step in the environment.
    """

    planning_steps: Annotated[int, Field(ge=1)] = 5


class DynaQ(QLearning):
    """Q-learning with a model: what happened the last time an action was taken in a state.

    After every observed step, ``planning_steps`` pairs of a state and an action seen before are drawn uniformly, and
    Eq. 2.8 is applied to what the model says of each. Parameters as of `apel.QLearning`.
    """

    options_type: ClassVar[type[QLearningOptions]] = DynaQOptions
    options: DynaQOptions

    def __init__(self, observation_space: Any, action_space: Any, seed: int, **options: Any) -> None:
        super().__init__(observation_space, action_space, seed, **options)
        self._model: dict[tuple[tuple[int, ...], int], _Outcome] = {}
        self._pairs: list[tuple[tuple[int, ...], int]] = []

    def learn(self, transition: Transition) -> None:
        """Learn from one step, remember it, and plan."""
        super().learn(transition)
        pair = observation_key(transition.observation), transition.action - self.first_action
        if pair not in self._model:
            self._pairs.append(pair)
        next_key = None if transition.terminated else observation_key(transition.next_observation)
        self._model[pair] = transition.reward, next_key
        for _ in range(self.options.planning_steps):
            key, action = self._pairs[integer(self.stream, len(self._pairs))]
            self.update(key, action, *self._model[key, action])

    def state(self) -> State:
        """As Q-learning's, with the model: pairs in the order in which they were first seen, and what came of each."""
        outcomes = [self._model[pair] for pair in self._pairs]
        return {
            **super().state(),
            "model": {
                "keys": packed_keys([key for key, _ in self._pairs]),
                "actions": np.array([action for _, action in self._pairs], dtype=np.int64),
                "rewards": np.array([reward for reward, _ in outcomes], dtype=np.float64),
                "terminal": np.array([end is None for _, end in outcomes], dtype=np.bool_),
                "next_keys": packed_keys([end for _, end in outcomes if end is not None]),
            },
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        super().restore(state)
        model, ends = state["model"], iter(unpacked_keys(state["model"]["next_keys"]))
        self._pairs = list(zip(unpacked_keys(model["keys"]), model["actions"].tolist(), strict=True))
        outcomes = [
            (reward, None if terminal else next(ends))
            for reward, terminal in zip(model["rewards"].tolist(), model["terminal"].tolist(), strict=True)
        ]
        self._model = dict(zip(self._pairs, outcomes, strict=True))
