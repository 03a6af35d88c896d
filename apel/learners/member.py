"""One learner at work in one run: it sees its own view of the raw observations, plays episodes, and learns from
others'.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.finite import FiniteModel
from apel.learners.base import Freezable, HasActionValues, Learner, Transition
from apel.representations import View
from apel.selection import starts_epoch
from apel.stacking import ViewStack
from apel.trajectory import Trajectory


class Codec:
    """How a raw observation stands in a trajectory: as it is, or, of a finite environment, as its state number."""

    def __init__(self, model: FiniteModel | None, space: spaces.Space[Any]) -> None:
        self._sizes = model.feature_sizes if model else None
        self._values = model.feature_values() if model else None
        self._is_scalar = isinstance(space, spaces.Discrete)

    def encode(self, observation: Any) -> Any:
        """The entry of a trajectory's ``observation``: a copy, since environments may reuse their arrays."""
        if self._sizes is None:
            return np.array(observation)
        return np.int64(np.ravel_multi_index(tuple(np.atleast_1d(observation)), self._sizes))

    def decode(self, entry: Any) -> Any:
        """The raw observation of such an entry."""
        if self._values is None:
            return entry
        values: NDArray[np.int64] = self._values[entry]
        return int(values[0]) if self._is_scalar else values


class Member:
    """A learner with its view and codec; with ``freezes`` its policy is frozen within each epoch of 2^β episodes."""

    def __init__(
        self,
        learner: Learner,
        view: View,
        codec: Codec,
        action_space: Any,
        *,
        freezes: bool = False,
    ) -> None:
        self.learner = learner
        self._view = view
        self._stack = ViewStack(view.stack)
        self._codec = codec
        self._first_action = int(action_space.start)
        self._freezes = freezes

    def play(self, environment: gymnasium.Env[Any, Any], seed: int, episode: int) -> Trajectory:
        """Act in the run's episode ``episode``, learning step by step."""
        self._freeze_at_epoch(episode)
        observation, _ = environment.reset(seed=seed)
        observations, actions, rewards, probabilities = [self._codec.encode(observation)], [], [], []
        seen = self._first_seen(observation)
        while True:
            action, probability = self.learner.act(seen)
            # Environments may reuse their arrays.
            seen = np.array(seen) if isinstance(seen, np.ndarray) else seen
            observation, reward, terminated, truncated, _ = environment.step(action)
            paid = float(reward)
            seen = self._learn(seen, action, paid, observation, terminated, truncated, probability)
            observations.append(self._codec.encode(observation))
            actions.append(action)
            rewards.append(paid)
            probabilities.append(probability)
            if terminated or truncated:
                break
        self.learner.end_episode()
        known = [p for p in probabilities if p is not None]
        return Trajectory(
            observation=np.array(observations),
            action=np.array(actions),
            reward=np.array(rewards, dtype=np.float64),
            terminated=bool(terminated),
            probability=np.array(known) if len(known) == len(actions) else None,
        )

    def evaluate(self, environment: gymnasium.Env[Any, Any], seed: int) -> tuple[int, float]:
        """Length and return of an episode in which it takes the first of its best actions, and nobody learns."""
        assert isinstance(self.learner, HasActionValues)  # noqa: S101 - make_member has seen to it
        observation, _ = environment.reset(seed=seed)
        seen, length, total = self._first_seen(observation), 0, 0.0
        while True:
            action = int(np.argmax(self.learner.action_values(seen))) + self._first_action
            observation, reward, terminated, truncated, _ = environment.step(action)
            length += 1
            total += float(reward)
            if terminated or truncated:
                return length, total
            following = self._stack.push(self._view(observation))
            is_over = self._view.terminals(False, observation)
            seen = self._first_seen(observation) if is_over else following

    def _freeze_at_epoch(self, episode: int) -> None:
        if self._freezes and starts_epoch(episode) and isinstance(self.learner, Freezable):
            self.learner.freeze()

    def learn(self, trajectory: Trajectory, episode: int) -> None:
        """Train on the run's episode ``episode``, which another learner played, in the same order."""
        self._freeze_at_epoch(episode)
        last = len(trajectory) - 1
        seen = self._first_seen(self._codec.decode(trajectory.observation[0]))
        for step in range(len(trajectory)):
            seen = self._learn(
                seen,
                int(trajectory.action[step]),
                float(trajectory.reward[step]),
                self._codec.decode(trajectory.observation[step + 1]),
                step == last and trajectory.terminated,
                step == last and not trajectory.terminated,
                None if trajectory.probability is None else trajectory.probability[step],
            )
        self.learner.end_episode()

    def _first_seen(self, observation: Any) -> Any:
        """What the learner sees where an episode begins for it."""
        return self._stack.start(self._view(observation))

    def _learn(
        self,
        seen: Any,
        action: int,
        reward: float,
        observation: Any,
        terminated: bool,
        truncated: bool,
        probability: NDArray[np.float64] | None,
    ) -> Any:
        """Learn from a step that led to ``observation``; what the learner sees there when it acts."""
        following = self._stack.push(self._view(observation))
        is_over = bool(self._view.terminals(terminated, observation))
        paid = float(self._view.rewards(reward, observation))
        is_cut = truncated and not is_over
        self.learner.learn(Transition(seen, action, paid, following, is_over, is_cut, probability))
        return self._first_seen(observation) if is_over and not terminated else following
