from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import apel.selectors
from apel.building.registry import SELECTORS
from apel.run.selection import Selector
from apel.run.state import is_compiled
from tests.apel.selectors.clock import Clock, bits

OPTIONS = [(name, {}) for name in SELECTORS] + [
    ("apel", {"tie_increment": True}),
    ("ssbas", {"normalise": "minmax_window"}),
    ("ssbas", {"normalise": "fixed_bounds", "bounds": (-1.0, 1.0), "window": 7}),
    ("sw_ucb", {"window": 1}),
    ("sw_ucb", {"window": 10, "normalise": "none"}),
    ("agent57", {"normalise": "minmax_window", "epsilon": 0.0}),
    ("ucb1", {"normalise": "none"}),
    ("ucb1", {"normalise": "fixed_bounds", "bounds": (0.0, 1.0)}),
    ("esbas", {"normalise": "minmax"}),
    ("discounted_ts", {"discount": 0.5, "bounds": (0.0, 1.0)}),
    ("dynamic_ts", {"capacity": 2.5}),
    ("exp3", {"mixing": 1.0}),
    ("exp3s", {"mixing": 0.01, "share": 1e-6}),
    ("corral", {"mixing": 0.0, "learning_rate": 5.0}),
    ("d3rb", {"confidence": 0.0}),
    ("epsilon_greedy", {"epsilon": 0.0}),
    ("incumbent", {"rehearsal_share": 0.3, "takeover_error": 0.5}),
]


def make(case: tuple[str, dict[str, object]]) -> Selector:
    return SELECTORS[case[0]](**case[1])


every = pytest.mark.parametrize("case", OPTIONS, ids=lambda case: "-".join([case[0], *map(str, case[1].values())]))

STREAMS: dict[str, Callable[[random.Random], float]] = {
    "noise": lambda draw: draw.gauss(0.0, 1.0),
    "equal": lambda _: -3.25,
    "huge": lambda draw: draw.choice([1e12, -1e12, 1e12 - 1.0, 0.0, 1e-12]),
    "whole": lambda draw: float(draw.randint(0, 2)),
    "limits": lambda draw: draw.choice([1e300, -1e300, 1.7e308, -1.7e308]),
}


@every
def test_is_a_compiled_selector(case: tuple[str, dict[str, object]]) -> None:
    """What is shipped can be called within compiled streaks, equal options make equal selectors."""
    selector = make(case)
    assert isinstance(selector, Selector)
    assert is_compiled(selector)
    assert selector.parameters().dtype == np.float64
    assert selector == make(case)


@every
@pytest.mark.parametrize("kind", [kind for kind in STREAMS if kind != "limits"])
def test_long_run(case: tuple[str, dict[str, object]], kind: str) -> None:
    """Whatever the performances: a valid learner, probabilities that sum to 1, a finite state, nobody left out."""
    clock, draw = Clock(make(case), 3, num_episodes=600, seed=4), random.Random(7)
    seen = set()
    for _ in range(600):
        selected = clock.select()
        assert 0 <= selected < 3
        assert clock.probability[selected] > 0.0
        assert min(clock.probability) >= 0.0
        assert sum(clock.probability) == pytest.approx(1.0, abs=1e-12)
        seen.add(selected)
        clock.observe(selected, STREAMS[kind](draw))
    assert np.isfinite(clock.rest).all()
    assert seen == ({0} if case[0] == "fixed" else {0, 1, 2})
    is_dirichlet = case[0].startswith("apel")
    assert all(c >= 1.0 for c in clock.concentration) if is_dirichlet else np.isnan(clock.concentration).all()


@every
def test_largest_numbers_break_nothing(case: tuple[str, dict[str, object]]) -> None:
    """Even where sums overflow, a valid learner is selected and the probabilities are probabilities."""
    clock, draw = Clock(make(case), 3, num_episodes=100), random.Random(1)
    for _ in range(100):
        assert 0 <= clock.select() < 3
        assert sum(clock.probability) == pytest.approx(1.0, abs=1e-12)
        clock.observe(draw.randrange(3), STREAMS["limits"](draw))


@every
def test_single_learner(case: tuple[str, dict[str, object]]) -> None:
    """An ensemble of one learner selects it with probability 1."""
    clock = Clock(make(case), 1, num_episodes=50)
    for episode in range(50):
        assert clock.select() == 0
        assert clock.probability == pytest.approx([1.0], abs=1e-15)
        clock.observe(0, math.sin(episode))
    assert np.isfinite(clock.rest).all()


@every
def test_draws_nothing_but_its_stream(case: tuple[str, dict[str, object]]) -> None:
    """Two runs with equal streams and performances are equal, value for value; the estimates are the latest."""
    one, two = (Clock(make(case), 3, num_episodes=100, seed=8) for _ in range(2))
    last = [math.nan] * 3
    for episode in range(100):
        selected = one.select()
        assert two.select() == selected
        for clock in (one, two):
            clock.observe(selected, math.sin(episode))
        last[selected] = math.sin(episode)
    assert bits(one.state) == bits(two.state)
    assert one.stream.tolist() == two.stream.tolist()
    assert bits(one.estimate) == bits(last)


SIZES: dict[str, Callable[[int, int], int]] = {
    "apel_recency": lambda n, _: 4 * n + 1,
    "apel_margin": lambda n, _: 3 * n + 1,
    "incumbent": lambda n, _: (6 + 134) * n + 7,
    "apel_surprise": lambda n, _: 6 * n,
    "ssbas": lambda n, t: 5 * n + 8 + 2 * (t // 2 + 2),
    "sw_ucb": lambda n, t: 5 * n + 8 + 4 * (min(1000, t) + 1),
    "agent57": lambda n, t: 5 * n + 8 + 2 * (min(90, t) + 1),
    "ucb1": lambda n, _: 5 * n + 2,
    "d_ucb": lambda n, _: 5 * n + 2,
    "esbas": lambda n, _: 5 * n + 4,
    "discounted_ts": lambda n, _: 5 * n + 2,
    "dynamic_ts": lambda n, _: 5 * n + 2,
    "exp3": lambda n, _: 4 * n + 4,
    "exp3s": lambda n, _: 4 * n + 4,
    "corral": lambda n, _: 6 * n + 4,
    "d3rb": lambda n, _: 7 * n + 2,
    "ed2rb": lambda n, _: 7 * n + 2,
}


@pytest.mark.parametrize("name", SELECTORS)
@pytest.mark.parametrize(("num_learners", "num_episodes"), [(1, 1), (2, 3000), (20, 50)])
def test_state_has_the_declared_size(name: str, num_learners: int, num_episodes: int) -> None:
    """Memory is O(learners), and the window where there is one."""
    expected = SIZES.get(name, lambda n, _: 3 * n)(num_learners, num_episodes)
    state = SELECTORS[name]().initial_state(num_learners, num_episodes)
    assert state.dtype == np.float64
    assert state.shape == (expected,)


@pytest.mark.parametrize("name", [name for name in SELECTORS if name not in {"uniform", "fixed"}])
def test_prefers_the_better_learner(name: str) -> None:
    """Of two learners that succeed with probability 0.2 and 0.8, the better one is selected far more often in the end.

    agent57 explores half of the time (its best is 0.75), ε-greedy trusts one episode: all others come to 0.85 or more.
    """
    clock, draw = Clock(SELECTORS[name](), 2, num_episodes=1500, seed=11), random.Random(3)
    late = 0
    for episode in range(1500):
        selected = clock.select()
        clock.observe(selected, float(draw.random() < (0.2, 0.8)[selected]))
        late += selected if episode >= 1000 else 0
    assert late / 500 > (0.65 if name in {"agent57", "epsilon_greedy"} else 0.8)


def test_only_esbas_freezes_policies() -> None:
    """ESBAS declares that learners act by frozen policies; nobody else does."""
    assert [name for name in SELECTORS if getattr(SELECTORS[name], "freezes_policies", False)] == ["esbas"]


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("ssbas", {"bounds": (0.0, 1.0)}),
        ("ssbas", {"normalise": "fixed_bounds"}),
        ("ssbas", {"normalise": "minmax"}),
        ("ssbas", {"window": 0}),
        ("ssbas", {"window": "third"}),
        ("sw_ucb", {"window": 0}),
        ("ucb1", {"normalise": "minmax_window"}),
        ("ucb1", {"exploration": 0.0}),
        ("d_ucb", {"discount": 0.0}),
        ("d_ucb", {"discount": 1.01}),
        ("esbas", {"bounds": (0.0, 1.0)}),
        ("agent57", {"epsilon": 1.1}),
        ("exp3", {"bounds": (1.0, 1.0)}),
        ("exp3", {"bounds": (0.0, math.inf)}),
        ("exp3", {"mixing": 0.0}),
        ("exp3s", {"hardness": 0}),
        ("discounted_ts", {"discount": 0.0}),
        ("dynamic_ts", {"capacity": 2.0}),
        ("corral", {"learning_rate": 0.0}),
        ("d3rb", {"failure_probability": 1.0}),
        ("ed2rb", {"min_coefficient": 0.0}),
        ("epsilon_greedy", {"epsilon": -0.1}),
        ("apel_recency", {"bound": 0.5}),
        ("apel_margin", {"strength": 1.5}),
        ("apel_surprise", {"memory": 0.0}),
        ("incumbent", {"rehearsal_share": 0.0}),
        ("incumbent", {"rehearsal_share": 1.0}),
        ("incumbent", {"takeover_error": 0.001}),
        ("incumbent", {"takeover_error": 0.6}),
    ],
)
def test_refuses_options_out_of_range(name: str, options: dict[str, object]) -> None:
    """The message names the option."""
    with pytest.raises(ValueError, match=next(iter(options))):
        SELECTORS[name](**options)


BOUNDED = [
    kind
    for kind in vars(apel.selectors).values()
    if {"bounds", "normalise"} <= set(getattr(kind, "__dataclass_fields__", {}))
]


@pytest.mark.parametrize("kind", BOUNDED, ids=lambda kind: kind.__name__)
def test_bounds_go_with_fixed_bounds_alone(kind: Any) -> None:
    """Every selector that takes bounds refuses them where they would not be used, and their lack where they would."""
    with pytest.raises(ValueError, match="bounds: found None with normalise: fixed_bounds"):
        kind(normalise="fixed_bounds")
    with pytest.raises(ValueError, match=rf"bounds: found \(0.0, 1.0\) with normalise: {kind().normalise}"):
        kind(bounds=(0.0, 1.0))
