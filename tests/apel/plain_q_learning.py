"""Q-learning on a finite environment as one plain loop (Algorithm 2, Eq. 2.8): the oracle of the compiled bank.

Python numbers, lists and dictionaries only; of the package it reads nothing but the arrays of a `FiniteModel`.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

from apel.finite import FiniteModel
from tests.apel.splitmix import SplitMix64, episode_seed


@dataclass
class PlainEpisode:
    """One episode, step by step."""

    states: list[int] = field(default_factory=list)
    actions: list[int] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    probabilities: list[list[float]] = field(default_factory=list)
    terminated: bool = False

    @property
    def total(self) -> float:
        """The return, added in order."""
        total = 0.0
        for reward in self.rewards:
            total += reward
        return total


class PlainQLearning:
    """One run: a model, the environment's key, and a learner that sees the features at the positions ``visible``.

    ``exploration`` is ε as a function of the episode's index and of the number of steps observed so far.
    """

    def __init__(
        self,
        model: FiniteModel,
        environment_key: int,
        seed: int,
        learning_rate: float,
        discount: float,
        exploration: Callable[[int, int], float],
        visible: list[int],
    ) -> None:
        self._next = model.next_cell.tolist()
        self._cumulative = model.cumulative.tolist()
        self._reward = model.reward.tolist()
        self._terminal = model.terminal.tolist()
        self._start = list(zip(model.start_cell.tolist(), model.start_cumulative.tolist(), strict=True))
        self._max_steps = model.max_steps
        self._num_actions = len(self._next[0])
        self._values_of = list(itertools.product(*(range(size) for size in model.feature_sizes)))
        self._num_distractor_values = len(self._values_of) // len(self._next)
        self._key = environment_key
        self._generator = SplitMix64.of_seed(seed)
        self._learning_rate, self._discount, self._exploration = learning_rate, discount, exploration
        self._visible = visible
        self._steps = 0
        self.table: defaultdict[tuple[int, ...], list[float]] = defaultdict(lambda: [0.0] * self._num_actions)

    def values(self, state: int) -> list[float]:
        """Q(s, ·) of a state of the environment."""
        return self.table[tuple(self._values_of[state][i] for i in self._visible)]

    def play(self, episode: int) -> PlainEpisode:
        """Act and learn for one episode."""
        generator, played = SplitMix64.of_seed(episode_seed(self._key, episode)), PlainEpisode()
        cell = self._start[0][0]
        if len(self._start) > 1:
            u = generator.uniform()
            cell = next(one for one, cumulative in self._start if u < cumulative)
        state = self._state(cell, generator)
        while not played.terminated and len(played.actions) < self._max_steps:
            action, probability = self._act(state, self._exploration(episode, self._steps))
            outcomes, outcome = self._cumulative[cell][action], 0
            if len(outcomes) > 1:
                u = generator.uniform()
                outcome = next(k for k, cumulative in enumerate(outcomes) if u < cumulative)
            reward = self._reward[cell][action][outcome]
            played.terminated = self._terminal[cell][action][outcome]
            cell = self._next[cell][action][outcome]
            successor = self._state(cell, generator)
            self.learn(state, action, reward, successor, played.terminated)
            played.states.append(state)
            played.actions.append(action)
            played.rewards.append(reward)
            played.probabilities.append(probability)
            state = successor
        played.states.append(state)
        return played

    def learn(self, state: int, action: int, reward: float, successor: int, terminated: bool) -> None:
        """Q(s, a) ← Q(s, a) + α (r + γ max Q(s′, ·) − Q(s, a))."""
        following = 0.0 if terminated else max(self.values(successor))
        values = self.values(state)
        values[action] += self._learning_rate * (reward + self._discount * following - values[action])
        self._steps += 1

    def learn_episode(self, played: PlainEpisode) -> None:
        """Learn from an episode that another learner played."""
        last = len(played.actions) - 1
        for t, action in enumerate(played.actions):
            self.learn(
                played.states[t], action, played.rewards[t], played.states[t + 1], played.terminated and t == last
            )

    def _state(self, cell: int, generator: SplitMix64) -> int:
        distractor = generator.integer(self._num_distractor_values) if self._num_distractor_values > 1 else 0
        return cell * self._num_distractor_values + distractor

    def _act(self, state: int, exploration: float) -> tuple[int, list[float]]:
        values = self.values(state)
        greedy = [action for action, value in enumerate(values) if value == max(values)]
        probability = [exploration / self._num_actions] * self._num_actions
        for action in greedy:
            probability[action] += (1.0 - exploration) / len(greedy)
        if self._generator.uniform() < exploration:
            return self._generator.integer(self._num_actions), probability
        return greedy[self._generator.integer(len(greedy)) if len(greedy) > 1 else 0], probability


def constant(rate: float) -> Callable[[int, int], float]:
    """The same ε always."""
    return lambda episode, steps: rate


def decaying(start: float, end: float, scale: float) -> Callable[[int, int], float]:
    """ε falls from ``start`` to ``end`` with the number of steps."""
    return lambda episode, steps: end + (start - end) * math.exp(-steps / scale)


def switched(before: float, switch_episode: int, after: float) -> Callable[[int, int], float]:
    """ε is another one from ``switch_episode`` on."""
    return lambda episode, steps: before if episode < switch_episode else after
