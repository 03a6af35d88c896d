from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

import apel
from apel.building import make_selector
from apel.run.rule import RuleSelector, SelectionRule, as_selector
from apel.run.selection import Selector, freezes_policies
from apel.run.state import is_compiled
from tests.apel.selectors.clock import Clock

HERE = "tests.apel.run.test_rule"


@dataclass(frozen=True)
class Window:
    """A learner drawn evenly; counts, the last performances of all, and the estimates before the last episode."""

    length: int = 3

    @property
    def fields(self) -> Mapping[str, float | Sequence[float]]:
        return {"count": 0.0, "recent": [np.nan] * self.length, "previous": 0.0}

    def select(self, state: Any, rng: np.random.Generator) -> int:
        return int(rng.integers(len(state.probability)))

    def observe(self, state: Any, selected: int, performance: float) -> None:
        state.count[selected] += 1.0
        state.recent[:] = [*state.recent[1:], performance]
        state.previous[:] = state.performance_estimate


class Freezing(Window):
    freezes_policies: ClassVar[bool] = True


def test_state_of_a_rule() -> None:
    """A number is one for every learner, a list is itself; the estimates are kept without the rule's doing."""
    clock = Clock(RuleSelector(Window()), 2)
    for selected, performance in [(0, 1.0), (1, 2.0), (1, 3.0), (1, 4.0)]:
        clock.observe(selected, performance)
    assert clock.estimate == [1.0, 4.0]
    assert clock.rest == [1.0, 3.0, 2.0, 3.0, 4.0, 1.0, 3.0]  # before the last episode
    assert clock.probability == [0.5, 0.5]
    assert np.isnan(clock.concentration).all()


def test_draws_follow_the_stream() -> None:
    """What a rule draws depends on the run's stream alone, and moves it by one step an episode."""
    one, two, other = (Clock(RuleSelector(Window()), 5, seed=seed) for seed in (1, 1, 2))
    draws = [[clock.select() for _ in range(40)] for clock in (one, two, other)]
    assert draws[0] == draws[1] != draws[2]
    assert set(draws[0]) == set(range(5))
    assert one.stream.tolist() == two.stream.tolist()


def test_rules_become_selectors() -> None:
    """A rule is named by import path like anything else, may be pickled, and a selector stays what it is."""
    made = make_selector(apel.SelectorConfig(f"{HERE}:Window", {"length": 2}))
    assert made == RuleSelector(Window(2)) == pickle.loads(pickle.dumps(made))
    assert isinstance(Window(), SelectionRule)
    assert isinstance(made, Selector)
    assert not is_compiled(made)
    assert as_selector(apel.Uniform()) == apel.Uniform()


def test_rules_may_freeze_policies() -> None:
    """As ESBAS, a rule may want policies that stay the same within an epoch."""
    assert freezes_policies(as_selector(Freezing()))
    assert not freezes_policies(as_selector(Window()))


@dataclass(frozen=True)
class Clashing(Window):
    @property
    def fields(self) -> Mapping[str, float | Sequence[float]]:
        return {"probability": 0.0}


def test_fields_that_cannot_be() -> None:
    """A rule cannot have a field of its own that every selector has."""
    with pytest.raises(ValueError, match="duplicate field name: 'probability'"):
        as_selector(Clashing()).initial_state(2, 10)


def test_in_an_ensemble() -> None:
    """The loop of Algorithm 5 takes a rule as it is."""
    world = apel.make_world(apel.EnvironmentConfig("FrozenLake-v1"), run_seed=1)
    learners = [apel.LearnerConfig("q_learning")] * 2
    records = list(apel.Ensemble(world, learners, Window(), seed=1, num_episodes=30).run())
    assert {record.selected for record in records} == {0, 1}
    assert records[-1].probability.tolist() == [0.5, 0.5]
