"""One run of a selector, and what tests feed it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import pytest

from apel.numerics.streams import stream_of_seed
from apel.run.selection import COMMON, Selector, common_blocks


class Clock:
    """One run's selector: its state and stream."""

    def __init__(self, selector: Selector, num_learners: int, num_episodes: int = 1000, seed: int = 0) -> None:
        self.selector, self.num_learners = selector, num_learners
        self.state = selector.initial_state(num_learners, num_episodes)
        self.stream = stream_of_seed(seed)
        self._parameters = selector.parameters()

    def select(self) -> int:
        return self.selector.select(self._parameters, self.num_learners, self.state, self.stream)

    def observe(self, selected: int, performance: float) -> None:
        self.selector.observe(self._parameters, self.num_learners, self.state, selected, performance)

    @property
    def probability(self) -> list[float]:
        return common_blocks(self.state, self.num_learners).probability.tolist()

    @property
    def estimate(self) -> list[float]:
        return common_blocks(self.state, self.num_learners).performance_estimate.tolist()

    @property
    def concentration(self) -> list[float]:
        return common_blocks(self.state, self.num_learners).concentration.tolist()

    @property
    def rest(self) -> list[float]:
        """The state behind the common blocks."""
        return self.state[COMMON.size(self.num_learners) :].tolist()


Trace = Iterable[tuple[Sequence[float], int, float]]
"""Probabilities before the episode, selected, performance."""


def check_trace(clock: Clock, trace: Trace) -> None:
    """The probabilities before each episode are as expected, whichever learner the stream then draws."""
    for episode, (expected, selected, performance) in enumerate(trace):
        drawn = clock.select()
        assert clock.probability == pytest.approx(expected, abs=1e-9), episode
        assert clock.probability[drawn] > 0.0
        clock.observe(selected, performance)


def bits(values: Iterable[float]) -> list[float]:
    """Values to be compared one by one, NaN included."""
    return [-math.inf if math.isnan(value) else value for value in values]
