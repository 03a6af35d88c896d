from __future__ import annotations

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apel.run.selection import COMMON
from apel.selectors import Apel, ApelMargin, ApelRecency, ApelSurprise
from tests.apel.selectors import frozen
from tests.apel.selectors.clock import Clock, bits

runs = given(
    num_learners=st.integers(1, 4),
    decay=st.sampled_from([0.0, 0.01, 0.3]),
    performances=st.lists(st.integers(-3, 3) | st.floats(-1e6, 1e6), max_size=60),
    seed=st.integers(0, 2**64 - 1),
)


@settings(max_examples=60)
@runs
def test_default_is_unchanged(num_learners: int, decay: float, performances: list[float], seed: int) -> None:
    """Without options APEL is what it was before there were any: same draws, same state, bit for bit."""
    clock = Clock(Apel(decay=decay), num_learners, seed=seed)
    twin = Clock(Apel(decay=decay), num_learners, seed=seed)
    for performance in performances:
        selected = clock.select()
        assert frozen.select_apel(num_learners, twin.state, twin.stream) == selected
        clock.observe(selected, performance)
        frozen.observe_apel(decay, num_learners, twin.state, selected, performance)
        assert bits(clock.state) == bits(twin.state)
    assert clock.stream.tolist() == twin.stream.tolist()


NEUTRAL = [ApelRecency, ApelMargin, ApelSurprise]


@pytest.mark.parametrize("variant", NEUTRAL)
@pytest.mark.parametrize("ties", [False, True])
@settings(max_examples=40)
@runs
def test_without_strength_it_is_apel(
    variant: type[Apel], ties: bool, num_learners: int, decay: float, performances: list[float], seed: int
) -> None:
    """At strength 0 each variant makes APEL's draws and has APEL's probabilities, estimates and concentrations."""
    plain = Clock(Apel(decay, tie_increment=ties), num_learners, seed=seed)
    other = Clock(variant(decay, tie_increment=ties, strength=0.0), num_learners, seed=seed)
    for performance in performances:
        selected = plain.select()
        assert other.select() == selected
        for clock in (plain, other):
            clock.observe(selected, performance)
        assert bits(plain.state) == bits(other.state[: COMMON.size(num_learners)])
    assert plain.stream.tolist() == other.stream.tolist()


@given(
    ties=st.booleans(),
    num_learners=st.integers(1, 4),
    performances=st.lists(st.integers(0, 9), max_size=60),
    table=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=10, max_size=10, unique=True),
    seed=st.integers(0, 2**64 - 1),
)
def test_apel_with_ties_sees_ranks_only(
    ties: bool, num_learners: int, performances: list[int], table: list[float], seed: int
) -> None:
    """With or without ties: nothing changes under a strictly increasing transformation of all performances."""
    increasing = sorted(table)
    selector = Apel(decay=0.05, tie_increment=ties)
    plain, transformed = (Clock(selector, num_learners, seed=seed) for _ in range(2))
    for performance in performances:
        selected = plain.select()
        assert transformed.select() == selected
        plain.observe(selected, float(performance))
        transformed.observe(selected, increasing[performance])
        assert transformed.concentration == plain.concentration


def test_ties_golden_trace() -> None:
    """Ties with the best other estimate count, but only when all have been selected; ν = 0.1."""
    clock = Clock(Apel(decay=0.1, tie_increment=True), 2)
    trace = [
        (0, 5.0, (1, 1)),  # learner 1 has no estimate
        (0, 5.0, (1, 1)),
        (1, 5.0, (1, 1.8)),  # a tie: (1 + 1) · 0.9
        (0, 5.0, (1.8, 1.62)),
        (0, 4.0, (1.62, 1.458)),  # below
        (1, 6.0, (1.458, 2.2122)),  # (1.458 + 1) · 0.9
    ]
    for selected, performance, expected in trace:
        clock.observe(selected, performance)
        assert clock.concentration == pytest.approx(expected, rel=1e-12)


def test_ties_keep_the_concentration_at_a_ceiling() -> None:
    """Where both reach the maximum, strict APEL decays to 1, 1; with ties the sum of concentrations stays up."""
    totals = {}
    for ties in (False, True):
        clock = Clock(Apel(decay=0.01, prior=(50.0, 1.0), tie_increment=ties), 2, seed=1)
        for _ in range(1000):
            clock.observe(clock.select(), 200.0)
        totals[ties] = sum(clock.concentration)
    assert totals[False] == 2.0
    # One increment per episode: the sum c obeys (c + 1) 0.99 = c, c = 99.
    assert totals[True] == pytest.approx(99.0, abs=1.0)


def test_recency_golden_trace() -> None:
    """min(1 + s (g − 1), b) with s = 0.5, b = 3, ν = 0."""
    clock = Clock(ApelRecency(decay=0.0, strength=0.5, bound=3.0), 2)
    trace = [
        (0, 1.0, (1, 1)),  # learner 1 has no estimate
        (1, 2.0, (1, 2)),  # its first selection: g = 1
        (1, 2.0, (1, 3)),  # g = 1
        (1, 3.0, (1, 4)),
        (0, 9.0, (3.5, 4)),  # episode 5 after episode 1: g = 4, 1 + 0.5 · 3
        (0, 9.0, (4.5, 4)),
        *[(0, 0.0, (4.5, 4))] * 9,  # no wins
        (1, 10.0, (4.5, 7)),  # episode 16 after episode 4: g = 12, 6.5 is cut to 3
    ]
    for selected, performance, expected in trace:
        clock.observe(selected, performance)
        assert clock.concentration == pytest.approx(expected, rel=1e-12)


def test_margin_golden_trace() -> None:
    """1 − s + s min(d/D, b): s = 1, b = 4, ρ = 0.5, ν = 0; then the same with s = 0.5."""
    trace = [
        # selected, performance, increment at s = 1
        (0, 10.0, 0.0),  # no other estimate: no margin, no increment
        (1, 12.0, 1.0),  # d = 2, D = 2
        (1, 20.0, 10 / 6),  # d = 10, D = (2 + 10) / 2 = 6
        (0, 5.0, 0.0),  # d = −15: a loss; D = (6 + 15) / 2 = 10.5
        (1, 8.0, 3 / 6.75),  # d = 3, D = (10.5 + 3) / 2
        (0, 8.0, 0.0),  # a tie; D = 3.375
    ]
    full, half = (Clock(ApelMargin(decay=0.0, strength=s, bound=4.0, memory=0.5), 2) for s in (1.0, 0.5))
    totals = {id(full): [1.0, 1.0], id(half): [1.0, 1.0]}
    for selected, performance, increment in trace:
        for clock, size in ((full, increment), (half, 0.5 + 0.5 * increment if increment else 0.0)):
            clock.observe(selected, performance)
            totals[id(clock)][selected] += size
            assert clock.concentration == pytest.approx(totals[id(clock)], rel=1e-12)
    assert full.rest == [3.375]


def test_margin_is_bounded() -> None:
    """A margin of more than b times the usual counts b."""
    clock = Clock(ApelMargin(decay=0.0, bound=4.0, memory=0.05), 2)
    clock.observe(0, 0.0)
    for _ in range(20):
        clock.observe(1, 1.0)
    before = clock.concentration[1]
    clock.observe(1, 1e6)
    assert clock.concentration[1] - before == 4.0


def test_surprise_golden_trace() -> None:
    """−log₂ P(X ≥ performance) bits: s = 1, b = 8, ρ = 0.1, ν = 0."""
    clock = Clock(ApelSurprise(decay=0.0, strength=1.0, bound=8.0, memory=0.1), 2)
    clock.observe(1, 0.0)
    trace = [
        (1.0, 1.0),  # no past
        (3.0, 1.0),  # a past of one
        (2.0, 1.0),  # past 1, 3: mean 2; the median has probability 1/2, one bit
        # past 1, 3, 2: mean 2, variance 2/3; one standard deviation above: P = 0.158655, 2.656 bits
        (2.0 + math.sqrt(2 / 3), -math.log2(0.15865525393145707)),
    ]
    total = 1.0
    for performance, increment in trace:
        clock.observe(0, performance)
        total += increment
        assert clock.concentration[0] == pytest.approx(total, rel=1e-9)
    clock.observe(0, 1e6)
    assert clock.concentration[0] == pytest.approx(total + 8.0, rel=1e-9)


def test_surprise_model_is_welford_then_exponential() -> None:
    """Mean and variance of all performances up to 1/ρ of them; then a share ρ of each new one."""
    clock, draw = Clock(ApelSurprise(memory=0.125), 1), random.Random(2)
    past = [draw.gauss(3.0, 2.0) for _ in range(8)]
    for performance in past:
        clock.observe(0, performance)
    mean = sum(past) / 8
    variance = sum((x - mean) ** 2 for x in past) / 8
    assert clock.rest == pytest.approx([8.0, mean, variance], rel=1e-12)
    clock.observe(0, 10.0)
    expected = [9.0, 0.875 * mean + 1.25, 0.875 * (variance + 0.125 * (10.0 - mean) ** 2)]
    assert clock.rest == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    "selector", [ApelRecency(decay=0.0), ApelMargin(decay=0.0), ApelSurprise(decay=0.0)], ids=lambda s: type(s).__name__
)
@given(episodes=st.lists(st.tuples(st.integers(0, 2), st.floats(-1e9, 1e9)), max_size=60))
def test_increments_are_bounded(selector: ApelRecency, episodes: list[tuple[int, float]]) -> None:
    """No episode adds less than 0 or more than b, and only the selected learner's concentration is touched."""
    clock = Clock(selector, 3)
    for selected, performance in episodes:
        before = clock.concentration
        clock.observe(selected, performance)
        difference = [after - b for after, b in zip(clock.concentration, before, strict=True)]
        assert 0.0 <= difference[selected] <= selector.bound + 1e-9
        assert all(difference[other] == 0.0 for other in range(3) if other != selected)
