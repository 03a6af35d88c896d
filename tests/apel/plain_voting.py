"""Voting ensembles (§2.5.1; Wiering & van Hasselt 2008) as plain formulas: the oracle of the compiled ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

from apel.dynamics.finite_model import FiniteModel
from tests.apel.plain_q_learning import PlainLearner, PlainQLearning
from tests.apel.splitmix import SplitMix64


def softmax(values: Sequence[float], temperature: float) -> list[float]:
    """exp(v / τ) / Σ exp(v / τ)."""
    powers = [math.exp((value - max(values)) / temperature) for value in values]
    return [power / sum(powers) for power in powers]


def ranks(values: Sequence[float]) -> list[float]:
    """Worst 1 … best m; equal values share the mean of the places that they take up."""
    ordered = sorted(values)
    places = {value: [i + 1 for i, other in enumerate(ordered) if other == value] for value in values}
    return [sum(places[value]) / len(places[value]) for value in values]


def boltzmann_preference(members: Sequence[Sequence[float]], method: str, member_temperature: float) -> list[float]:
    """Sum or product of the members' own Boltzmann policies."""
    policies = [softmax(values, member_temperature) for values in members]
    combine = sum if method == "boltzmann_addition" else math.prod
    return [combine(column) for column in zip(*policies, strict=True)]


class PlainVoting(PlainLearner):
    """Members that vote, and all learn."""

    def __init__(
        self,
        model: FiniteModel,
        environment_key: int,
        seed: int,
        members: Sequence[PlainQLearning],
        method: str,
        temperature: float,
        member_temperature: float,
    ) -> None:
        super().__init__(model, environment_key)
        self._generator = SplitMix64.of_seed(seed)
        self.members = members
        self._method, self._temperature, self._member_temperature = method, temperature, member_temperature

    def begin(self, episode: int) -> None:
        """For every member."""
        for member in self.members:
            member.begin(episode)

    def act(self, state: int, episode: int) -> tuple[int, list[float]]:
        """Draw from π(a) ∝ exp(p(a) / τ), or p(a)^(1/τ) of the Boltzmann methods."""
        preference = self._preference(state, draws=True)
        if self._method in ("majority", "rank"):
            probability = softmax(preference, self._temperature)
        else:
            # Relative to the largest, so that no power underflows.
            powers = [(p / max(preference)) ** (1.0 / self._temperature) for p in preference]
            probability = [power / sum(powers) for power in powers]
        u, cumulative = self._generator.uniform(), 0.0
        for action, one in enumerate(probability[:-1]):
            cumulative += one
            if u < cumulative:
                return action, probability
        return len(probability) - 1, probability

    def learn(self, state: int, action: int, reward: float, successor: int, terminated: bool) -> None:
        """Every member."""
        for member in self.members:
            member.learn(state, action, reward, successor, terminated)

    def judged(self, state: int) -> list[float]:
        """The preferences, without chance."""
        return self._preference(state, draws=False)

    def _preference(self, state: int, *, draws: bool) -> list[float]:
        values = [member.judged(state) for member in self.members]
        if self._method == "majority":
            votes = [self._vote(one, draws=draws) for one in values]
            return [float(votes.count(action)) for action in range(len(values[0]))]
        if self._method == "rank":
            return [sum(column) for column in zip(*map(ranks, values), strict=True)]
        return boltzmann_preference(values, self._method, self._member_temperature)

    def _vote(self, values: Sequence[float], *, draws: bool) -> int:
        best = [action for action, value in enumerate(values) if value == max(values)]
        return best[self._generator.integer(len(best))] if draws and len(best) > 1 else best[0]
