"""One run of a batched learner as a plain `Learner`, so that no algorithm is written twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.learners.banks.batched_learner import BatchedLearner, Transitions
from apel.learners.base import HasReplayMemory, State, Transition
from apel.learners.supported_spaces import NETWORKS, SupportedSpaces

_ONLY = np.zeros(1, dtype=np.int64)


class SingleLearner:
    """A `Learner` that is a batched one of a single run.

    Attributes
    ----------
    batched_type:
        Makes the batched learner, see `BatchedLearner`. Wherever all runs of a shard have the same options and the same
        view, one object of it holds them all.
    """

    off_policy: ClassVar[bool] = True
    supported_spaces: ClassVar[SupportedSpaces] = NETWORKS
    batched_type: ClassVar[Callable[..., BatchedLearner]]

    def __init__(self, observation_space: spaces.Space[Any], action_space: Any, seed: int, **options: Any) -> None:
        self._batched = type(self).batched_type(observation_space, int(action_space.n), [seed], **options)
        self._num_actions = int(action_space.n)
        self._first_action = int(action_space.start)

    def act(self, observation: Any) -> tuple[int, NDArray[np.float64]]:
        """An action, and the probabilities of all."""
        actions, probability = self._batched.act(_ONLY, np.asarray(observation)[None])
        return int(actions[0]) + self._first_action, probability[0]

    def action_values(self, observation: Any) -> NDArray[np.float64]:
        """See `HasActionValues`."""
        return self._batched.action_values(_ONLY, np.asarray(observation)[None])[0]

    def learn(self, transition: Transition) -> None:
        """Learn from one step."""
        unknown = np.full(self._num_actions, np.nan)
        probability = unknown if transition.probability is None else np.asarray(transition.probability)
        self._batched.learn(
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
        self._batched.end_episode(_ONLY)

    def freeze(self) -> None:
        """See `Freezable`."""
        self._batched.freeze(_ONLY)

    def replay_own(self, share: float) -> None:
        """See `HasReplayMemory`.

        Raises
        ------
        TypeError
            If it has none.
        """
        if not isinstance(self._batched, HasReplayMemory):
            message = f"{type(self._batched).__name__} has no replay memory"
            raise TypeError(message)
        self._batched.replay_own(share)

    def state(self) -> State:
        """Everything needed to go on exactly here."""
        return self._batched.state()

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._batched.restore(state)
