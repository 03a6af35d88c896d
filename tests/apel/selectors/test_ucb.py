from __future__ import annotations

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apel.run.selection import Selector
from apel.selectors import Agent57, DUcb, EpsilonGreedy, Esbas, Ssbas, SwUcb, Ucb1
from apel.selectors.ssbas import view_state
from apel.selectors.windows import Window, view_window
from tests.apel.selectors import frozen
from tests.apel.selectors.clock import Clock, bits, check_trace

TIE, FIRST, SECOND = (0.5, 0.5), (1.0, 0.0), (0.0, 1.0)


def test_ucb1_golden_trace() -> None:
    """x̄ + √(2 ln n / nₖ) by hand: each learner once, then the larger index, ties evenly."""
    trace = [
        (TIE, 0, 1.0),
        (SECOND, 1, 0.5),  # never tried
        (FIRST, 0, 0.0),  # n = 2, equal bonuses: 1 > 0.5
        (SECOND, 1, 0.5),  # n = 3: 0.5 + √(ln 3) = 1.548 < 0.5 + √(2 ln 3) = 1.982
        (TIE, 0, 0.0),  # both 1/2 of two
        (SECOND, 1, 0.0),
    ]
    check_trace(Clock(Ucb1(normalise="none"), 2), trace)


def test_ucb1_maps_means_to_the_range_seen() -> None:
    """Means are divided by the range of all performances so far: 10 … 20 counts as 0 … 1."""
    trace = [
        (TIE, 0, 10.0),
        (SECOND, 1, 20.0),
        (SECOND, 1, 10.0),  # 0 + √(2 ln 2) < 1 + √(2 ln 2)
        (SECOND, 1, 10.0),  # n = 3: √(2 ln 3) = 1.482 < (15 − 10)/10 + √(ln 3) = 1.548
        (FIRST, 0, 10.0),  # n = 4: √(2 ln 4) = 1.665 > (13.3 − 10)/10 + √(2 ln 4 / 3) = 1.295
    ]
    check_trace(Clock(Ucb1(), 2), trace)


def test_ucb1_clips_to_fixed_bounds() -> None:
    """Performances beyond the bounds are taken in at the bounds; the estimate stays the raw performance."""
    clock = Clock(Ucb1(normalise="fixed_bounds", bounds=(0.0, 10.0)), 2)
    clock.observe(0, 25.0)
    clock.observe(1, -3.0)
    assert clock.rest == [0.0, 10.0, 1.0, 1.0, 10.0, 0.0]
    assert clock.estimate == [25.0, -3.0]


def test_d_ucb_golden_trace() -> None:
    """γ = 1/2, ξ = 2: counts and sums are halved after every episode."""
    clock = Clock(DUcb(discount=0.5, normalise="none"), 2)
    trace = [
        (TIE, 0, 1.0),
        (SECOND, 1, 0.6),
        # N = 0.5, 1, n = 1.5: 1 + √(2 · 0.4055 / 0.5) = 2.274 > 0.6 + √(2 · 0.4055) = 1.501
        (FIRST, 0, 0.0),
        # N = 1.25, 0.5, n = 1.75: 0.2 + √(2 · 0.5596 / 1.25) = 1.146 < 0.6 + √(2 · 0.5596 / 0.5) = 2.096
        (SECOND, 1, 1.0),
    ]
    check_trace(clock, trace)
    assert clock.rest == pytest.approx([0.0, 1.0, 0.625, 1.25, 0.125, 1.15])


def test_sw_ucb_golden_trace() -> None:
    """τ = 2, ξ = 1: with two learners in the window the later mean decides, a missing one is forced."""
    trace = [
        (TIE, 0, 1.0),
        (SECOND, 1, 0.5),
        (FIRST, 0, 0.2),  # 1 > 0.5
        (SECOND, 1, 0.1),  # the window holds 1 (0.5), 0 (0.2)
        (FIRST, 0, 0.0),  # 0 (0.2), 1 (0.1)
        (SECOND, 1, 0.9),
        (SECOND, 1, 0.9),  # 0 (0), 1 (0.9)
        (FIRST, 0, 0.0),  # 1, 1: 0 is missing
    ]
    check_trace(Clock(SwUcb(window=2, normalise="none"), 2), trace)


def test_esbas_golden_trace() -> None:
    """ξ = 1/4: epochs of 1, 2 and 4 episodes, each of which begins with every learner once."""
    trace = [
        (TIE, 0, 5.0),  # epoch 0
        (TIE, 0, 5.0),  # epoch 1: nothing is known
        (SECOND, 1, 1.0),
        (TIE, 0, 1.0),  # epoch 2
        (SECOND, 1, 1.2),
        (SECOND, 1, 0.0),  # n = 2: 1 < 1.2
        (FIRST, 0, 1.0),  # n = 3: 1 + √(0.25 ln 3) = 1.524 > 0.6 + √(0.125 ln 3) = 0.971
        (TIE, 0, 1.0),  # epoch 3
    ]
    check_trace(Clock(Esbas(), 2), trace)


def test_esbas_epochs() -> None:
    """Epoch β covers the 0-based episodes 2^β − 1 … 2^(β+1) − 2: nothing is counted exactly before its first."""
    clock = Clock(Esbas(), 2)
    fresh = []
    for episode in range(600):
        if clock.rest[2:6] == [0.0] * 4:
            fresh.append(episode)
        clock.observe(clock.select(), 1.0)
    assert fresh == [2**beta - 1 for beta in range(10)]


def test_agent57_golden_trace() -> None:
    """τ = 3, β = 1, ε = 1/2: each learner once in order; then 1/4 for either and 1/2 for the larger index."""
    first, second = (0.75, 0.25), (0.25, 0.75)
    trace = [
        (FIRST, 0, 1.0),
        (SECOND, 1, 0.5),
        (first, 0, 0.0),  # 1 + 1 > 0.5 + 1
        (second, 1, 0.5),  # 0.5 + √(1/2) = 1.207 < 0.5 + 1
        (second, 1, 0.5),  # 1 (0.5), 0 (0), 1 (0.5): 0 + 1 < 0.5 + √(1/2)
        (second, 1, 0.5),
        (first, 0, 0.5),  # 1, 1, 1: 0 has left the window
    ]
    check_trace(Clock(Agent57(window=3), 2), trace)


def test_epsilon_greedy_golden_trace() -> None:
    """ε = 0.2: unselected learners first, then the better latest performance; ties evenly."""
    trace = [(TIE, 0, 5.0), ((0.1, 0.9), 1, 3.0), ((0.9, 0.1), 0, 3.0), (TIE, 0, 2.0), ((0.1, 0.9), 1, 2.0)]
    check_trace(Clock(EpsilonGreedy(epsilon=0.2), 2), trace)


def test_epsilon_is_the_share_of_uniform_selections() -> None:
    """Selections come with the probabilities that are written down."""
    clock = Clock(EpsilonGreedy(epsilon=0.3), 3, seed=2)
    for learner in range(3):
        clock.observe(learner, float(learner))
    draws = [clock.select() for _ in range(20_000)]
    assert clock.probability == pytest.approx([0.1, 0.1, 0.8])
    for learner, expected in enumerate(clock.probability):
        assert draws.count(learner) / 20_000 == pytest.approx(expected, abs=5 * math.sqrt(0.25 / 20_000))


def assert_alike(one: Selector, two: Selector, num_learners: int, performances: list[float], seed: int) -> None:
    """Two selectors make the same draws with the same probabilities."""
    first, second = (Clock(s, num_learners, num_episodes=max(len(performances), 1), seed=seed) for s in (one, two))
    for performance in performances:
        selected = first.select()
        assert second.select() == selected
        assert first.probability == second.probability
        for clock in (first, second):
            clock.observe(selected, performance)


runs = given(
    num_learners=st.integers(1, 4),
    performances=st.lists(st.integers(-5, 5), max_size=80),
    seed=st.integers(0, 2**64 - 1),
)


@settings(max_examples=40)
@runs
def test_d_ucb_without_discount_is_ucb1(num_learners: int, performances: list[float], seed: int) -> None:
    """γ = 1 and ξ = 4 ξ' = 2: UCB1, selection for selection."""
    assert_alike(DUcb(discount=1.0, exploration=4 * 0.5), Ucb1(exploration=2.0), num_learners, performances, seed)


@settings(max_examples=40)
@runs
def test_sw_ucb_with_a_window_of_everything_is_ucb1(num_learners: int, performances: list[float], seed: int) -> None:
    """τ ≥ T and the same ξ: UCB1, also in how it normalises."""
    assert_alike(SwUcb(window=10_000, exploration=2.0), Ucb1(exploration=2.0), num_learners, performances, seed)


@settings(max_examples=40)
@runs
def test_ssbas_with_a_constant_window_is_sw_ucb(num_learners: int, performances: list[float], seed: int) -> None:
    """The one differs from the other by the window's length alone."""
    ssbas = Ssbas(exploration=1.0, window=10, normalise="minmax_window")
    assert_alike(ssbas, SwUcb(window=10), num_learners, performances, seed)


@settings(max_examples=40)
@runs
def test_ssbas_default_is_unchanged(num_learners: int, performances: list[float], seed: int) -> None:
    """Without options SSBAS is what it was before there were any: same draws, same probabilities, bit for bit."""
    clock = Clock(Ssbas(), num_learners, num_episodes=80, seed=seed)
    state, stream = frozen.ssbas_state(num_learners, 80), clock.stream.copy()
    for whole in performances:
        performance = whole + 0.1 * whole * whole
        selected = clock.select()
        assert frozen.select_ssbas(4.921, num_learners, state, stream) == selected
        assert clock.probability == state[:num_learners].tolist()
        clock.observe(selected, performance)
        frozen.observe_ssbas(num_learners, state, selected, performance)
    assert bits(clock.estimate) == bits(state[num_learners : 2 * num_learners])
    assert clock.stream.tolist() == stream.tolist()


@settings(max_examples=20)
@given(scale=st.floats(1e-6, 1e6), shift=st.floats(-10.0, 10.0), seed=st.integers(0, 2**32))
@pytest.mark.parametrize(
    "selector",
    [Ssbas(normalise="minmax_window"), SwUcb(window=16), Ucb1(), Esbas(normalise="minmax")],
    ids=lambda s: type(s).__name__,
)
def test_minmax_forgets_the_unit(selector: Selector, scale: float, shift: float, seed: int) -> None:
    """Selections do not change under a positive affine transformation of all performances.

    These are drawn from a normal distribution, so that no two indices come within rounding of each other.
    """
    draw = random.Random(seed)
    plain, transformed = (Clock(selector, 2, num_episodes=100, seed=seed) for _ in range(2))
    for _ in range(100):
        selected = plain.select()
        assert transformed.select() == selected
        assert transformed.probability == plain.probability
        performance = draw.gauss(selected, 1.0)
        plain.observe(selected, performance)
        transformed.observe(selected, scale * (performance + shift))


@settings(max_examples=40)
@given(
    num_learners=st.integers(1, 4),
    window=st.just("half") | st.integers(1, 30),
    episodes=st.lists(st.tuples(st.integers(0, 3), st.integers(-9, 9)), max_size=120),
)
def test_window_statistics_are_those_of_a_naive_recomputation(
    num_learners: int, window: str | int, episodes: list[tuple[int, int]]
) -> None:
    """Counts, sums, least and largest of the window, carried along, are what the whole history gives."""
    clock = Clock(Ssbas(window=window, normalise="minmax_window"), num_learners, num_episodes=max(len(episodes), 1))
    history: list[tuple[int, int]] = []
    for learner, performance in episodes:
        history.append((learner % num_learners, performance))
        clock.observe(*history[-1])
        length = len(history) // 2 if window == "half" else min(int(window), len(history))
        inside = history[len(history) - length :]
        carried = window_of(clock)
        assert (carried.begin, carried.end) == (len(history) - length, len(history))
        played = [[p for k, p in inside if k == learner] for learner in range(num_learners)]
        assert carried.num_selections.tolist() == [float(len(p)) for p in played]
        assert carried.performance_sum.tolist() == [float(sum(p)) for p in played]
        if inside:
            assert extremes_of(clock) == (min(p for _, p in inside), max(p for _, p in inside))


def window_of(clock: Clock) -> Window:
    return view_window(view_state(clock.state, clock.num_learners).window, clock.num_learners)


def extremes_of(clock: Clock) -> tuple[float, float]:
    """Least and largest performance by the two queues' heads."""
    window = window_of(clock)
    capacity, rings = int(window.capacity[0]), window.rings.tolist()
    heads = (
        rings[2 * capacity + int(window.minima[0]) % capacity],
        rings[3 * capacity + int(window.maxima[0]) % capacity],
    )
    return tuple(rings[2 * (int(episode) % capacity) + 1] for episode in heads)  # type: ignore[return-value]


def test_fixed_bounds_clip_what_the_window_keeps() -> None:
    """One episode of −10⁶ counts as the lower bound."""
    clock = Clock(Ssbas(normalise="fixed_bounds", bounds=(-100.0, 1.0), window=4), 2)
    draw = random.Random(0)
    for performance in (5.0, -1e6, 0.5, draw.random()):
        clock.observe(0, performance)
    assert window_of(clock).performance_sum[0] == pytest.approx(1.0 - 100.0 + 0.5 + random.Random(0).random())
