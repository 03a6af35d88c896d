"""One run of a stacked learner as a plain `Learner`: a bank of one, so that no algorithm is written twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.learners.base import State, Transition
from apel.learners.stacked import StackedLearner, Transitions

_ONLY = np.zeros(1, dtype=np.int64)


class SingleLearner:
    """A `Learner` that is a stacked one of a single run.

    Attributes
    ----------
    stacked_type:
        Makes the stacked learner, see `StackedLearner`. Wherever all runs of a shard have the same options and the same
        view, one object of it holds them all.
    """

    off_policy: ClassVar[bool] = True
    stacked_type: ClassVar[Callable[..., StackedLearner]]

    def __init__(self, observation_space: spaces.Space[Any], action_space: Any, seed: int, **options: Any) -> None:
        self._stacked = type(self).stacked_type(observation_space, int(action_space.n), [seed], **options)
        self._num_actions = int(action_space.n)
        self._first_action = int(action_space.start)

    def act(self, observation: Any) -> tuple[int, NDArray[np.float64]]:
        """An action, and the probabilities of all."""
        actions, probability = self._stacked.act(_ONLY, np.asarray(observation)[None])
        return int(actions[0]) + self._first_action, probability[0]

    def action_values(self, observation: Any) -> NDArray[np.float64]:
        """See `HasActionValues`."""
        return self._stacked.action_values(_ONLY, np.asarray(observation)[None])[0]

    def learn(self, transition: Transition) -> None:
        """Learn from one step."""
        unknown = np.full(self._num_actions, np.nan)
        probability = unknown if transition.probability is None else transition.probability
        self._stacked.learn(
            _ONLY,
            Transitions(
                observation=np.asarray(transition.observation)[None],
                action=np.array([transition.action - self._first_action]),
                reward=np.array([transition.reward]),
                next_observation=np.asarray(transition.next_observation)[None],
                terminated=np.array([transition.terminated]),
                truncated=np.array([transition.truncated]),
                probability=probability[None],
            ),
        )

    def end_episode(self) -> None:
        """The episode is over."""
        self._stacked.end_episode(_ONLY)

    def freeze(self) -> None:
        """See `Freezable`."""
        self._stacked.freeze(_ONLY)

    def state(self) -> State:
        """Everything needed to go on exactly here."""
        return self._stacked.state()

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._stacked.restore(state)
