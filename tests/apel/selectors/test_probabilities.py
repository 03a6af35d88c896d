"""EXP3, CORRAL, Thompson sampling, regret balancing: rules whose steps are held against plain Python."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apel.numerics.streams import stream_of_seed
from apel.run.selection import Selector
from apel.selectors import Corral, D3rb, DiscountedTs, DynamicTs, Ed2rb, Exp3, Exp3S
from apel.selectors.thompson import beta
from tests.apel.selectors.clock import Clock

UNIT = (0.0, 1.0)


def probability_after(clock: Clock, selected: int, performance: float) -> list[float]:
    """Probabilities of the next episode."""
    clock.observe(selected, performance)
    clock.select()
    return clock.probability


# EXP3, EXP3.S


def test_exp3_golden_trace() -> None:
    """γ = 0.2, K = 2: x̂ = 1/0.5 = 2, w₀ = exp(0.2 · 2 / 2); then x̂ = 0.5/p₁ for the other."""
    clock = Clock(Exp3(mixing=0.2, bounds=UNIT), 2)
    clock.select()
    assert clock.probability == [0.5, 0.5]
    p0 = 0.8 * math.exp(0.2) / (math.exp(0.2) + 1.0) + 0.1
    assert probability_after(clock, 0, 1.0) == pytest.approx([p0, 1.0 - p0])
    w1 = math.exp(0.2 * (0.5 / (1.0 - p0)) / 2)
    p0 = 0.8 * math.exp(0.2) / (math.exp(0.2) + w1) + 0.1
    assert probability_after(clock, 1, 0.5) == pytest.approx([p0, 1.0 - p0])
    assert probability_after(clock, 1, 0.0) == pytest.approx([p0, 1.0 - p0])  # a reward of 0 changes nothing


def test_exp3s_golden_step() -> None:
    """γ = 0.2, α = 0.1, K = 2: w₀ = e^0.2 + 0.1 e, w₁ = 1 + 0.1 e, since W = 2."""
    clock = Clock(Exp3S(mixing=0.2, share=0.1, bounds=UNIT), 2)
    clock.select()
    w0, w1 = math.exp(0.2) + 0.1 * math.e, 1.0 + 0.1 * math.e
    assert probability_after(clock, 0, 1.0)[0] == pytest.approx(0.8 * w0 / (w0 + w1) + 0.1)


@settings(max_examples=30)
@given(
    num_learners=st.integers(1, 4),
    mixing=st.sampled_from([0.05, 0.3, 1.0]),
    share=st.sampled_from([0.0, 1e-3, 0.5]),
    rewards=st.lists(st.floats(0.0, 1.0), max_size=60),
    seed=st.integers(0, 2**32),
)
def test_exp3_agrees_with_plain_weights(
    num_learners: int, mixing: float, share: float, rewards: list[float], seed: int
) -> None:
    """Logarithms of weights, divided by the largest, give the probabilities of the weights themselves."""
    selector: Selector = Exp3S(mixing, share, bounds=UNIT) if share else Exp3(mixing, bounds=UNIT)
    clock = Clock(selector, num_learners, seed=seed)
    k, weights = num_learners, [1.0] * num_learners
    for reward in rewards:
        selected, total = clock.select(), sum(weights)
        p = [(1.0 - mixing) * w / total + mixing / k for w in weights]
        assert clock.probability == pytest.approx(p, rel=1e-9)
        weights[selected] *= math.exp(mixing * reward / p[selected] / k)
        weights = [w + math.e * share / k * total for w in weights]
        clock.observe(selected, reward)
        assert max(clock.rest[4:]) == 0.0
        assert np.isfinite(clock.rest).all()


def test_exp3_constants_of_the_paper() -> None:
    """γ and α of Corollaries 3.2 and 8.3 for T = 1000, K = 2, S = 3."""
    assert Clock(Exp3(), 2).rest[2] == pytest.approx(math.sqrt(2 * math.log(2) / ((math.e - 1) * 1000)))
    _, _, gamma, share = Clock(Exp3S(hardness=3), 2).rest[:4]
    assert gamma == pytest.approx(math.sqrt(2 * (3 * math.log(2000) + math.e) / ((math.e - 1) * 1000)))
    assert share == pytest.approx(math.e * 1e-3 / 2)


@pytest.mark.parametrize(("name", "forgives"), [("exp3", False), ("exp3s", True)])
def test_exp3s_finds_a_learner_that_turns_good(name: str, forgives: bool) -> None:
    """After 2000 episodes in which learner 0 was best, 500 in which it is learner 1: only EXP3.S has changed sides."""
    clock = Clock(Exp3(mixing=0.1, bounds=UNIT) if name == "exp3" else Exp3S(mixing=0.1, share=1e-3, bounds=UNIT), 2)
    for episode in range(2_500):
        selected = clock.select()
        clock.observe(selected, float(selected == (episode >= 2_000)))
    assert (clock.probability[1] > 0.5) == forgives


# CORRAL


def test_corral_golden_step() -> None:
    """M = 2, η = 1, ℓ = (2, 0), p = (1/2, 1/2): with a = 2 − λ, 1/(a + 2) + 1/a = 1, so that a = √2."""
    clock = Clock(Corral(learning_rate=1.0, mixing=0.0, bounds=UNIT), 2)
    clock.select()
    assert probability_after(clock, 0, 0.0) == pytest.approx([1 / (2 + math.sqrt(2)), 1 / math.sqrt(2)], rel=1e-12)
    assert clock.rest[6:] == [1.0, 1.0, 4.0, 4.0]  # 1/p₀ = 3.41 is below ρ = 4
    probability_after(clock, 0, 0.0)
    inverse = 1.0 / clock.probability[0]
    assert inverse > 4.0
    # ρ₀ = 2/p₀, and η₀ grows by e^(1/ln T), T = 1000.
    assert clock.rest[6:] == pytest.approx([math.exp(1 / math.log(1000)), 1.0, 2.0 * inverse, 4.0])


def test_corral_mixes_and_leaves_a_loss_of_zero() -> None:
    """p̄ = (1 − γ) p + γ/M, and a performance at the upper bound has no loss."""
    clock = Clock(Corral(learning_rate=1.0, mixing=0.2, bounds=UNIT), 2)
    clock.select()
    p = probability_after(clock, 0, 0.0)
    assert p[0] == pytest.approx(0.8 / (2 + math.sqrt(2)) + 0.1)
    assert probability_after(clock, 0, 1.0) == p


def plain_descent(p: list[float], rate: list[float], loss: list[float]) -> list[float]:
    """Algorithm 2 of the paper by bisection, in plain Python."""
    low, high = min(loss), min([max(loss), *(1 / (r * q) + x for q, r, x in zip(p, rate, loss, strict=True))])

    def step(at: float) -> list[float]:
        return [1 / q + r * (x - at) for q, r, x in zip(p, rate, loss, strict=True)]

    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if sum(1 / d for d in step(middle)) < 1 else (low, middle)
    new = [1 / d for d in step(low)]
    return [q / sum(new) for q in new]


@settings(max_examples=40)
@given(
    num_learners=st.integers(1, 5),
    learning_rate=st.sampled_from([0.01, 0.3, 2.0, 20.0]),
    mixing=st.sampled_from([0.0, 0.01, 0.5]),
    rewards=st.lists(st.floats(0.0, 1.0), max_size=50),
    seed=st.integers(0, 2**32),
)
def test_corral_agrees_with_bisection(
    num_learners: int, learning_rate: float, mixing: float, rewards: list[float], seed: int
) -> None:
    """Probabilities, rates and thresholds are those of Algorithms 1 and 2 written out, with bisection for λ."""
    clock = Clock(Corral(learning_rate=learning_rate, mixing=mixing, bounds=UNIT), num_learners, seed=seed)
    m, growth = num_learners, math.exp(1 / math.log(1000))
    p, rate, threshold = [1 / m] * m, [learning_rate] * m, [2.0 * m] * m
    for reward in rewards:
        selected = clock.select()
        mixed = [(1 - mixing) * q + mixing / m for q in p]
        assert clock.probability == pytest.approx(mixed, rel=1e-6)
        loss = [(1 - reward) / mixed[k] if k == selected else 0.0 for k in range(m)]
        p = plain_descent(p, rate, loss) if max(loss) > 0 and m > 1 else p
        clock.observe(selected, reward)
        for k in range(m):
            inverse = 1 / ((1 - mixing) * p[k] + mixing / m)
            if abs(inverse / threshold[k] - 1) < 1e-6:
                return  # on the threshold within rounding
            if inverse > threshold[k]:
                threshold[k], rate[k] = 2 * inverse, rate[k] * growth
        assert clock.rest[4:] == pytest.approx([*p, *rate, *threshold], rel=1e-6)


# Thompson sampling


def test_discounted_ts_golden_trace() -> None:
    """γ = 1/2: all learners' successes and failures are halved after every episode."""
    clock = Clock(DiscountedTs(discount=0.5, bounds=UNIT), 2)
    for selected, performance, expected in [
        (0, 1.0, [1.0, 0.0, 0.0, 0.0]),
        (0, 0.25, [0.75, 0.0, 0.75, 0.0]),
        (1, 0.0, [0.375, 0.0, 0.375, 1.0]),
    ]:
        clock.observe(selected, performance)
        assert clock.rest[2:] == expected


def test_dynamic_ts_golden_trace() -> None:
    """C = 4: counts grow to 4, then (3.5, 1.5) · 4/5."""
    clock = Clock(DynamicTs(capacity=4.0, bounds=UNIT), 2)
    for performance, expected in [(1.0, [2.0, 1.0]), (1.0, [3.0, 1.0]), (0.5, [2.8, 1.2]), (0.5, [2.64, 1.36])]:
        clock.observe(0, performance)
        assert [clock.rest[2], clock.rest[4]] == pytest.approx(expected)
    assert [clock.rest[3], clock.rest[5]] == [1.0, 1.0]


@pytest.mark.parametrize(("successes", "failures"), [(1.0, 1.0), (2.0, 5.0), (0.3, 0.7), (0.02, 20.0)])
def test_beta_has_its_moments(successes: float, failures: float) -> None:
    """Mean a/(a + b) and variance m (1 − m)/(a + b + 1), also with parameters below 1."""
    stream = stream_of_seed(3)
    draws = np.array([beta(stream, successes, failures) for _ in range(20_000)])
    mean = successes / (successes + failures)
    variance = mean * (1 - mean) / (successes + failures + 1)
    assert ((draws >= 0.0) & (draws <= 1.0)).all()
    assert draws.mean() == pytest.approx(mean, abs=5 * math.sqrt(variance / 20_000))
    assert draws.var() == pytest.approx(variance, rel=0.25)


def test_thompson_selects_by_the_probability_of_being_best() -> None:
    """Beta(2, 1) beats Beta(1, 1) with probability ∫ 2x · x dx = 2/3; the drawn one is written down."""
    clock = Clock(DiscountedTs(bounds=UNIT), 2, seed=6)
    clock.observe(0, 1.0)
    draws = []
    for _ in range(20_000):
        draws.append(clock.select())
        assert clock.probability == [1.0 - draws[-1], float(draws[-1])]
    assert draws.count(0) / 20_000 == pytest.approx(2 / 3, abs=5 * math.sqrt(0.25 / 20_000))


def test_dynamic_ts_survives_a_learner_that_always_fails() -> None:
    """α falls geometrically, in the end to 0: the learner's draws are 0, nothing is NaN."""
    clock = Clock(DynamicTs(capacity=3.0, bounds=UNIT), 2)
    for _ in range(4_000):
        clock.observe(0, 0.0)
    assert clock.rest[2] == 0.0 or clock.rest[2] < 1e-300
    clock.observe(1, 1.0)
    assert {clock.select() for _ in range(200)} == {1}


# Normalisation of the rules that need [0, 1]


@pytest.mark.parametrize("name", ["discounted_ts", "exp3", "corral", "d3rb"])
def test_running_range_and_fixed_bounds(name: str) -> None:
    """Without bounds the range seen so far, ½ while it is a point; with bounds, clipping."""
    make = {"discounted_ts": DiscountedTs, "exp3": Exp3, "corral": Corral, "d3rb": D3rb}[name]
    running, fixed = Clock(make(), 2), Clock(make(bounds=(-2.0, 2.0)), 2)
    for clock in (running, fixed):
        clock.select()
        for selected, performance in [(0, 3.0), (1, 3.0), (0, -5.0), (1, 1.0)]:
            clock.observe(selected, performance)
    assert running.rest[:2] == [-5.0, 3.0]
    assert fixed.rest[:2] == [-2.0, 2.0]
    if name == "discounted_ts":
        g = 0.95
        # Rewards ½, ½, 0 and 6/8; clipped to −2 … 2: 1, 1, 0 and 3/4.
        assert running.rest[2:4] == pytest.approx([0.5 * g**3, 0.5 * g**2 + 0.75])
        assert fixed.rest[2:4] == pytest.approx([g**3, g**2 + 0.75])


# Regret balancing


def test_d3rb_golden_trace() -> None:
    """No bonus (c = 0), d_min = 1: the test ûᵢ + dᵢ/√nᵢ < max û, and φ = d √n."""
    clock = Clock(D3rb(confidence=0.0, bounds=UNIT), 2)
    trace = [
        ((0.5, 0.5), 0, 1.0),
        ((0.5, 0.5), 1, 0.0),  # φ₀ = 1 · √1
        ((0.5, 0.5), 1, 0.0),  # 0 + 1/√1 is not below 1: φ₁ = 1
        ((1.0, 0.0), 0, 1.0),  # 0 + 1/√2 < 1: d₁ = 2, φ₁ = 2 √2
    ]
    for expected, selected, performance in trace:
        clock.select()
        assert clock.probability == list(expected)
        clock.observe(selected, performance)
    assert clock.rest[6:] == pytest.approx([1.0, 2.0, math.sqrt(2), math.sqrt(8)])
    for _ in range(7):
        clock.observe(0, 1.0)
    clock.select()
    assert clock.probability == [0.0, 1.0]  # φ₀ = √9 > √8


def test_ed2rb_golden_trace() -> None:
    """No bonus (c = 0), d_min = 1: d = max(1, √n (max û − û)), φ between itself and its double."""
    clock = Clock(Ed2rb(confidence=0.0, bounds=UNIT), 2)
    clock.observe(0, 1.0)
    for count, coefficient, potential in [(1, 1.0, 1.0), (2, math.sqrt(2), 2.0), (3, math.sqrt(3), 3.0)]:
        clock.observe(1, 0.0)
        assert clock.rest[3] == count
        assert [clock.rest[7], clock.rest[9]] == pytest.approx([coefficient, potential])
    for _ in range(3):
        clock.observe(1, 1.0)
    # û₁ = 1/2 of six: d = √6/2 = 1.22, d √n = 3 is no less than φ = 3.
    assert [clock.rest[7], clock.rest[9]] == pytest.approx([math.sqrt(6) / 2, 3.0])


@pytest.mark.parametrize("estimates", [False, True])
@settings(max_examples=25)
@given(
    num_learners=st.integers(1, 4),
    confidence=st.sampled_from([0.0, 0.1, 1.0]),
    rewards=st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0]), max_size=80),
    seed=st.integers(0, 2**32),
)
def test_regret_balancing_agrees_with_plain_python(
    estimates: bool, num_learners: int, confidence: float, rewards: list[float], seed: int
) -> None:
    """Coefficients and potentials are those of the rules written out, and the smallest potential is selected."""
    make = Ed2rb if estimates else D3rb
    selector = make(min_coefficient=0.1, confidence=confidence, failure_probability=0.05, bounds=UNIT)
    clock, draw, m = Clock(selector, num_learners), random.Random(seed), num_learners
    played: list[list[float]] = [[] for _ in range(m)]
    d, phi = [0.1] * m, [0.1] * m

    def bonus(n: int) -> float:
        return confidence * math.sqrt(math.log(m * max(math.log(n), 1.0) / 0.05) / n)

    for reward in rewards:
        clock.select()
        smallest = [k for k in range(m) if phi[k] <= min(phi) * (1 + 1e-9)]
        assert sum(clock.probability[k] for k in smallest) == pytest.approx(1.0)
        i = draw.randrange(m)
        clock.observe(i, reward)
        played[i].append(reward)
        mean = [sum(p) / len(p) if p else 0.0 for p in played]
        highest = max(mean[k] - bonus(len(played[k])) for k in range(m) if played[k])
        root, upper = math.sqrt(len(played[i])), mean[i] + bonus(len(played[i]))
        if estimates:
            d[i] = max(0.1, root * (highest - upper))
            phi[i] = min(max(d[i] * root, phi[i]), 2 * phi[i])
        else:
            if abs(highest - upper - d[i] / root) < 1e-9:
                return  # on the threshold within rounding
            d[i] *= 2 if highest - upper > d[i] / root else 1
            phi[i] = d[i] * root
        assert clock.rest[2 + 2 * m :] == pytest.approx([*d, *phi], rel=1e-9)
