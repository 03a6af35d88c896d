"""One plain learner in one run, step by step, written as simply as possible: what the lockstep bank is held against."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from apel.building import make_learner
from apel.configs import LearnerConfig
from apel.environments import World
from apel.experience.trajectory import Trajectory
from apel.learners import Transition
from apel.run.selection import starts_epoch


class PlainAgent:
    """A learner with its representation; raw observations stand in its trajectories, or the numbers of states."""

    def __init__(
        self, config: LearnerConfig, world: World, run_seed: int, index: int, *, freezes: bool = False
    ) -> None:
        learner, self._view = make_learner(config, world, run_seed, index)
        self.learner: Any = learner
        self._seen = config.representation
        self._model = world.model
        self._first_action = int(world.environment.action_space.start)  # type: ignore[attr-defined]
        self._freezes = freezes
        self._views: list[Any] = []

    def play(self, environment: gymnasium.Env[Any, Any], seed: int, episode: int) -> Trajectory:
        """Act in an episode, learning step by step."""
        self._freeze(episode)
        observation, _ = environment.reset(seed=seed)
        entries, actions, rewards, probabilities = [self._entry(observation)], [], [], []
        seen, ends = self._start(observation), False
        while not ends:
            action, probability = self.learner.act(seen)
            observation, reward, terminated, truncated, _ = environment.step(action)
            seen = self._learn(seen, action, float(reward), observation, terminated, truncated, probability)
            entries.append(self._entry(observation))
            actions.append(action)
            rewards.append(float(reward))
            probabilities.append(probability)
            ends = terminated or truncated
        self.learner.end_episode()
        known = None if any(p is None for p in probabilities) else np.array(probabilities)
        return Trajectory(np.array(entries), np.array(actions), np.array(rewards), bool(terminated), known)

    def learn(self, trajectory: Trajectory, episode: int) -> None:
        """Train on an episode that another learner played."""
        self._freeze(episode)
        seen, last = self._start(self._raw(trajectory.observation[0])), len(trajectory) - 1
        for t in range(len(trajectory)):
            mu = None if trajectory.probability is None else trajectory.probability[t]
            ends = t == last and trajectory.terminated, t == last and not trajectory.terminated
            raw = self._raw(trajectory.observation[t + 1])
            seen = self._learn(seen, int(trajectory.action[t]), float(trajectory.reward[t]), raw, *ends, mu)
        self.learner.end_episode()

    def evaluate(self, environment: gymnasium.Env[Any, Any], seed: int) -> tuple[int, float]:
        """Length and return of an episode without exploring or learning."""
        observation, _ = environment.reset(seed=seed)
        seen, length, total, ends = self._start(observation), 0, 0.0, False
        while not ends:
            action = int(np.argmax(self.learner.action_values(seen))) + self._first_action
            observation, reward, terminated, truncated, _ = environment.step(action)
            length, total, ends = length + 1, total + float(reward), terminated or truncated
            pushed = self._push(observation)
            seen = self._start(observation) if self._ends_alone(observation) else pushed
        return length, total

    def _learn(
        self, seen: Any, action: int, reward: float, raw: Any, terminated: bool, truncated: bool, probability: Any
    ) -> Any:
        """Learn from a step that led to ``raw``; what the learner sees there when it acts."""
        following, alone = self._push(raw), self._ends_alone(raw)
        paid = reward if self._seen.reward is None else float(raw[self._seen.reward])
        ends = bool(terminated or alone)
        self.learner.learn(Transition(seen, action, paid, following, ends, truncated and not ends, probability))
        return self._start(raw) if alone and not terminated else following

    def _ends_alone(self, raw: Any) -> bool:
        return self._seen.terminal is not None and bool(raw[self._seen.terminal] != 0)

    def _start(self, raw: Any) -> Any:
        self._views = [np.array(self._view(raw))] * self._seen.stack
        return np.stack(self._views) if self._seen.stack > 1 else self._view(raw)

    def _push(self, raw: Any) -> Any:
        self._views = [*self._views[1:], np.array(self._view(raw))]
        return np.stack(self._views) if self._seen.stack > 1 else self._view(raw)

    def _freeze(self, episode: int) -> None:
        if self._freezes and starts_epoch(episode):
            self.learner.freeze()

    def _entry(self, raw: Any) -> Any:
        if self._model is None:
            return np.array(raw)
        return np.ravel_multi_index(tuple(np.atleast_1d(raw)), self._model.feature_sizes)

    def _raw(self, entry: Any) -> Any:
        if self._model is None:
            return entry
        values = self._model.feature_values()[entry]
        return values if len(values) > 1 else int(values[0])
