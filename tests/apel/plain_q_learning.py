"""Q-learning and Dyna-Q on a finite environment as one plain loop (Algorithm 2, Eq. 2.8): the oracle of the compiled
bank.

Python numbers, lists and dictionaries only; of the package it reads nothing but the arrays of a `FiniteModel`.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

from apel.dynamics.finite_model import FiniteModel
from tests.apel.splitmix import SplitMix64, episode_seed, evaluation_seed

Key = tuple[int, ...]


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


class PlainWorld:
    """One run's environment: a model, and the key of its episodes."""

    def __init__(self, model: FiniteModel, key: int) -> None:
        self._next = model.next_cell.tolist()
        self._cumulative = model.cumulative.tolist()
        self._reward = model.reward.tolist()
        self._terminal = model.terminal.tolist()
        self._start = list(zip(model.start_cell.tolist(), model.start_cumulative.tolist(), strict=True))
        self._num_distractor_values = math.prod(model.feature_sizes) // len(self._next)
        self._key = key
        self.features_of = list(itertools.product(*(range(size) for size in model.feature_sizes)))
        self.max_steps = model.max_steps
        self.num_actions = len(self._next[0])

    def reset(self, episode: int, *, evaluation: bool = False) -> int:
        """The first state of an episode, or of the evaluation after it."""
        seed = evaluation_seed(self._key, episode) if evaluation else episode_seed(self._key, episode)
        self._generator = SplitMix64.of_seed(seed)
        self._cell = self._start[0][0]
        if len(self._start) > 1:
            u = self._generator.uniform()
            self._cell = next(one for one, cumulative in self._start if u < cumulative)
        return self._state()

    def step(self, action: int) -> tuple[int, float, bool]:
        """Next state, reward, and whether the episode terminated."""
        outcomes, outcome = self._cumulative[self._cell][action], 0
        if len(outcomes) > 1:
            u = self._generator.uniform()
            outcome = next(k for k, cumulative in enumerate(outcomes) if u < cumulative)
        reward = self._reward[self._cell][action][outcome]
        terminated = self._terminal[self._cell][action][outcome]
        self._cell = self._next[self._cell][action][outcome]
        return self._state(), reward, terminated

    def _state(self) -> int:
        distractor = self._generator.integer(self._num_distractor_values) if self._num_distractor_values > 1 else 0
        return self._cell * self._num_distractor_values + distractor


class PlainLearner:
    """The loop of one run; what acts and learns is for subclasses to say."""

    def __init__(self, model: FiniteModel, environment_key: int) -> None:
        self.world = PlainWorld(model, environment_key)

    def begin(self, episode: int) -> None:
        """Before the first step of an episode, whoever plays it."""

    def act(self, state: int, episode: int) -> tuple[int, list[float]]:
        """An action, and the probabilities of all."""
        raise NotImplementedError

    def learn(self, state: int, action: int, reward: float, successor: int, terminated: bool) -> None:
        """Learn from one step."""
        raise NotImplementedError

    def judged(self, state: int) -> list[float]:
        """What it thinks of each action when it does not explore."""
        raise NotImplementedError

    def play(self, episode: int) -> PlainEpisode:
        """Act and learn for one episode."""
        self.begin(episode)
        state, played = self.world.reset(episode), PlainEpisode()
        while not played.terminated and len(played.actions) < self.world.max_steps:
            action, probability = self.act(state, episode)
            successor, reward, played.terminated = self.world.step(action)
            self.learn(state, action, reward, successor, played.terminated)
            played.states.append(state)
            played.actions.append(action)
            played.rewards.append(reward)
            played.probabilities.append(probability)
            state = successor
        played.states.append(state)
        return played

    def learn_episode(self, played: PlainEpisode, episode: int) -> None:
        """Learn from an episode that another learner played."""
        self.begin(episode)
        last = len(played.actions) - 1
        for t, action in enumerate(played.actions):
            self.learn(
                played.states[t], action, played.rewards[t], played.states[t + 1], played.terminated and t == last
            )

    def evaluate(self, episode: int) -> tuple[int, float]:
        """Length and return of another episode, with the first of the best actions, and without learning."""
        state, length, total, terminated = self.world.reset(episode, evaluation=True), 0, 0.0, False
        while not terminated and length < self.world.max_steps:
            values = self.judged(state)
            state, reward, terminated = self.world.step(values.index(max(values)))
            length += 1
            total += reward
        return length, total


class PlainQLearning(PlainLearner):
    """Q-learning that sees the features at the positions ``visible``.

    ``exploration`` is ε as a function of the episode's index and of the number of steps observed so far. With
    ``planning_steps`` it is Dyna-Q; with ``freezes`` it acts in the episodes 2^β − 1 … 2^(β+1) − 2 on the table that it
    had before the first of them.
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
        *,
        takes_first: bool = False,
        planning_steps: int = 0,
        freezes: bool = False,
    ) -> None:
        super().__init__(model, environment_key)
        self._generator = SplitMix64.of_seed(seed)
        self._learning_rate, self._discount, self._exploration = learning_rate, discount, exploration
        self._keys = [tuple(values[i] for i in visible) for values in self.world.features_of]
        self._takes_first, self._freezes = takes_first, freezes
        self._steps = 0
        self.table: defaultdict[Key, list[float]] = defaultdict(self._zeros)
        self._acting = self.table
        self._planning_steps = planning_steps
        self._model: dict[tuple[Key, int], tuple[float, Key | None]] = {}
        self._pairs: list[tuple[Key, int]] = []

    def values(self, state: int) -> list[float]:
        """Q(s, ·) of a state of the environment."""
        return self.table[self._keys[state]]

    def judged(self, state: int) -> list[float]:
        """Q(s, ·), of the frozen table where there is one."""
        return self._acting[self._keys[state]]

    def begin(self, episode: int) -> None:
        """Freeze where episode + 1 is a power of two."""
        if self._freezes and math.log2(episode + 1).is_integer():
            self._acting = defaultdict(self._zeros, {key: list(values) for key, values in self.table.items()})

    def act(self, state: int, episode: int) -> tuple[int, list[float]]:
        """ε-greedy."""
        values, exploration = self.judged(state), self._exploration(episode, self._steps)
        num_actions = len(values)
        greedy = [action for action, value in enumerate(values) if value == max(values)]
        if self._takes_first:
            greedy = greedy[:1]
        probability = [exploration / num_actions] * num_actions
        for action in greedy:
            probability[action] += (1.0 - exploration) / len(greedy)
        if self._generator.uniform() < exploration:
            return self._generator.integer(num_actions), probability
        return greedy[self._generator.integer(len(greedy)) if len(greedy) > 1 else 0], probability

    def learn(self, state: int, action: int, reward: float, successor: int, terminated: bool) -> None:
        """One update from what happened; then as many as are planned from what is remembered."""
        key, next_key = self._keys[state], None if terminated else self._keys[successor]
        self._update(key, action, reward, next_key)
        self._steps += 1
        if self._planning_steps:
            if (key, action) not in self._model:
                self._pairs.append((key, action))
            self._model[key, action] = reward, next_key
            for _ in range(self._planning_steps):
                drawn = self._pairs[self._generator.integer(len(self._pairs))]
                self._update(*drawn, *self._model[drawn])

    def _update(self, key: Key, action: int, reward: float, next_key: Key | None) -> None:
        """Q(s, a) ← Q(s, a) + α (r + γ max Q(s′, ·) − Q(s, a))."""
        following = 0.0 if next_key is None else max(self.table[next_key])
        values = self.table[key]
        values[action] += self._learning_rate * (reward + self._discount * following - values[action])

    def _zeros(self) -> list[float]:
        return [0.0] * self.world.num_actions


def constant(rate: float) -> Callable[[int, int], float]:
    """The same ε always."""
    return lambda episode, steps: rate


def decaying(start: float, end: float, scale: float) -> Callable[[int, int], float]:
    """ε falls from ``start`` to ``end`` with the number of steps."""
    return lambda episode, steps: end + (start - end) * math.exp(-steps / scale)


def switched(before: float, switch_episode: int, after: float) -> Callable[[int, int], float]:
    """ε is another one from ``switch_episode`` on."""
    return lambda episode, steps: before if episode < switch_episode else after
