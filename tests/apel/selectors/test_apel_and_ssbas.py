from __future__ import annotations

import math
import os
import random
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apel.run.selection import COMMON, Selector, new_state
from apel.selectors import Apel, Fixed, Ssbas, Uniform
from tests.apel.plain_selector import PlainSelector
from tests.apel.selectors.clock import Clock

SHIPPED = [Apel(), Ssbas(), Uniform(), Fixed()]


# All selectors


@pytest.mark.parametrize("selector", [*SHIPPED, PlainSelector(Apel())], ids=lambda s: type(s).__name__)
def test_satisfies_the_protocol(selector: Selector) -> None:
    """Every shipped selector, and one of plain functions, is a `Selector`."""
    assert isinstance(selector, Selector)
    assert selector.parameters().dtype == np.float64


@pytest.mark.parametrize("selector", SHIPPED, ids=lambda s: type(s).__name__)
def test_state_opens_with_the_common_blocks(selector: Selector) -> None:
    """A state is float64 and opens with probability | estimate | concentration; no estimate is set at first."""
    state = selector.initial_state(3, 10)
    assert state.dtype == np.float64
    expected_probability = [1.0, 0.0, 0.0] if isinstance(selector, Fixed) else [1 / 3] * 3
    assert state[:3].tolist() == expected_probability
    assert np.isnan(state[3:6]).all()
    assert state[6:9].tolist() == [1.0] * 3 if isinstance(selector, Apel) else np.isnan(state[6:9]).all()


def test_layout_of_the_common_blocks() -> None:
    """They hold uniform probabilities, no estimates, and equal concentrations, in this order."""
    np.testing.assert_array_equal(new_state(COMMON, 2, concentration=4.0), [0.5, 0.5, math.nan, math.nan, 4.0, 4.0])


@pytest.mark.parametrize("selector", SHIPPED, ids=lambda s: type(s).__name__)
def test_single_learner_is_always_selected(selector: Selector) -> None:
    """An ensemble of one learner selects it with probability 1, whatever its performance."""
    clock = Clock(selector, 1)
    for performance in (-5.0, 0.0, 3.0, -100.0, 7.0, 7.0):
        assert clock.select() == 0
        assert clock.probability == [1.0]
        clock.observe(0, performance)


@pytest.mark.parametrize("selector", SHIPPED, ids=lambda s: type(s).__name__)
@settings(max_examples=25)
@given(
    num_learners=st.integers(1, 5),
    performances=st.lists(st.floats(-1e6, 1e6), max_size=40),
    seed=st.integers(0, 2**64 - 1),
)
def test_probabilities_and_estimates(
    selector: Selector, num_learners: int, performances: list[float], seed: int
) -> None:
    """Probabilities lie in [0, 1] and sum to 1, the selected learner's is above 0, estimates are last performances."""
    clock = Clock(selector, num_learners, seed=seed)
    last = [math.nan] * num_learners
    for performance in performances:
        selected = clock.select()
        assert 0 <= selected < num_learners
        assert clock.probability[selected] > 0.0
        assert all(0.0 <= p <= 1.0 for p in clock.probability)
        assert sum(clock.probability) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_array_equal(clock.estimate, last)
        clock.observe(selected, performance)
        last[selected] = performance
    np.testing.assert_array_equal(clock.estimate, last)


# APEL


def test_apel_golden_trace_of_two_learners() -> None:
    """Algorithm 5 by hand, ν = 0.1: nothing before all were selected, ties do not count, no concentration below 1."""
    clock = Clock(Apel(decay=0.1), 2)
    trace = [
        # selected, performance, concentrations after it
        (0, 5.0, (1, 1)),  # learner 1 has no estimate: no increment; 0.9 is lifted to 1
        (0, 7.0, (1, 1)),
        (1, 6.0, (1, 1)),  # 6 < 7
        (0, 8.0, (1.8, 1)),  # 8 > 6: (1 + 1) · 0.9
        (0, 8.0, (2.52, 1)),  # 2.8 · 0.9
        (1, 8.0, (2.268, 1)),  # a tie: decay alone
        (1, 9.0, (2.0412, 1.8)),  # 9 > 8
        (0, 8.5, (1.83708, 1.62)),  # 8.5 < 9
        (0, 3.0, (1.653372, 1.458)),
        (0, 3.0, (1.4880348, 1.3122)),
        (0, 3.0, (1.33923132, 1.18098)),
        (0, 3.0, (1.205308188, 1.062882)),
        (0, 3.0, (1.0847773692, 1)),  # 1.062882 · 0.9 = 0.957 is lifted to 1
        (0, 3.0, (1, 1)),
    ]
    for selected, performance, expected in trace:
        clock.observe(selected, performance)
        assert clock.concentration == pytest.approx(expected, rel=1e-12)
    assert clock.estimate == [3.0, 9.0]


def test_apel_golden_trace_of_three_learners() -> None:
    """With three learners the selected one must beat the best of the others, and all must have been selected."""
    clock = Clock(Apel(decay=0.1), 3)
    trace = [
        (0, 1.0, (1, 1, 1)),
        (1, 2.0, (1, 1, 1)),
        (1, 3.0, (1, 1, 1)),  # better than learner 0, but learner 2 was never selected
        (2, 4.0, (1, 1, 1.8)),  # the last one to be selected is best at once
        (1, 3.5, (1, 1, 1.62)),  # beats learner 0, not learner 2
        (0, 9.0, (1.8, 1, 1.458)),
        (2, 9.0, (1.62, 1, 1.3122)),  # ties with learner 0
        (1, 9.5, (1.458, 1.8, 1.18098)),
    ]
    for selected, performance, expected in trace:
        clock.observe(selected, performance)
        assert clock.concentration == pytest.approx(expected, rel=1e-12)
    assert clock.estimate == [9.0, 9.5, 9.0]


@pytest.mark.parametrize("decay", [0.001, 0.01, 0.1, 0.4])
@pytest.mark.parametrize("num_learners", [2, 5])
def test_apel_follows_the_closed_form(decay: float, num_learners: int) -> None:
    """Always selected and always best: αₖ = a_ss + (1 − ν)ᵏ (α₀ − a_ss) with a_ss = 1/ν − 1 (Eq. 3.7)."""
    clock = Clock(Apel(decay=decay), num_learners)
    for other in range(1, num_learners):
        clock.observe(other, 0.0)
    steady = 1 / decay - 1
    for k in range(1, 400):
        clock.observe(0, 1.0)
        expected = steady + (1 - decay) ** k * (1.0 - steady)
        assert clock.concentration == pytest.approx([expected] + [1.0] * (num_learners - 1), rel=1e-9)


def test_apel_without_decay_counts_wins() -> None:
    """With ν = 0 a concentration is 1 plus the number of wins."""
    clock = Clock(Apel(decay=0.0), 2)
    clock.observe(1, 0.0)
    for _ in range(50):
        clock.observe(0, 1.0)
    assert clock.concentration == [51.0, 1.0]


def test_apel_idle_concentration_decays_to_one() -> None:
    """A learner that never wins again has αₖ = max(α₀ (1 − ν)ᵏ, 1) (Eq. 3.10 with the floor of Eq. 3.5)."""
    clock = Clock(Apel(decay=0.01, prior=(1.0, 99.0)), 2)
    clock.observe(1, 0.0)
    for k in range(2, 600):
        clock.observe(0, 1.0)
        assert clock.concentration[1] == pytest.approx(max(99.0 * 0.99**k, 1.0), rel=1e-9)
    # ln 99 / −ln 0.99 = 457.2: the floor is reached well within the loop.
    assert clock.concentration[1] == 1.0


def test_apel_settles_where_only_the_selected_can_win() -> None:
    """In play the inferior of two learners is selected with probability ν / (1 − ν): only the selected one can win.

    Increments come with probability p: (c + p) (1 − ν) = c at c = 1/ν − 2 with p = c / (c + 1), so that
    1 − p = ν / (1 − ν). For ν = 0.05 that is 1/19 = 0.0526 (by Eq. 3.9 it would be 0.05).
    """
    clock = Clock(Apel(decay=0.05), 2, seed=5)
    bad = []
    for _ in range(22_000):
        selected = clock.select()
        clock.observe(selected, float(selected == 0))
        bad.append(selected)
    # 5 standard errors of 20 000 draws are 0.0079; the spread of c itself adds about a percent of the value.
    assert sum(bad[2_000:]) / 20_000 == pytest.approx(1 / 19, abs=0.009)


@given(
    decay=st.floats(0.0, 1.0, exclude_max=True),
    num_learners=st.integers(1, 4),
    episodes=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 5)), max_size=60),
)
def test_apel_agrees_with_a_plain_loop(decay: float, num_learners: int, episodes: Sequence[tuple[int, int]]) -> None:
    """Concentrations are those of Algorithm 5 written out in plain Python, and never below 1."""
    clock = Clock(Apel(decay=decay), num_learners)
    estimate: dict[int, int] = {}
    concentration = [1.0] * num_learners
    for learner, performance in episodes:
        selected = learner % num_learners
        clock.observe(selected, float(performance))
        estimate[selected] = performance
        others = [value for other, value in estimate.items() if other != selected]
        if len(estimate) == num_learners and all(performance > value for value in others):
            concentration[selected] += 1.0
        concentration = [max(c * (1.0 - decay), 1.0) for c in concentration]
        assert clock.concentration == concentration
        assert min(clock.concentration) >= 1.0


@given(
    decay=st.sampled_from([0.0, 0.01, 0.3]),
    num_learners=st.integers(1, 4),
    performances=st.lists(st.integers(0, 9), max_size=60),
    table=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=10, max_size=10, unique=True),
    seed=st.integers(0, 2**64 - 1),
)
def test_apel_sees_ranks_only(
    decay: float, num_learners: int, performances: list[int], table: list[float], seed: int
) -> None:
    """Selections and concentrations do not change under a strictly increasing transformation of all performances."""
    increasing = sorted(table)
    plain, transformed = (Clock(Apel(decay=decay), num_learners, seed=seed) for _ in range(2))
    for performance in performances:
        selected = plain.select()
        assert transformed.select() == selected
        plain.observe(selected, float(performance))
        transformed.observe(selected, increasing[performance])
        assert transformed.concentration == plain.concentration


def test_apel_selects_in_proportion_to_concentration() -> None:
    """P(L = i) = cᵢ / Σc: drawing p ~ Dirichlet(c) and then L ~ Categorical(p) averages to the mean of p."""
    clock = Clock(Apel(prior=(1.0, 3.0, 6.0)), 3, seed=3)
    draws = np.array([clock.select() for _ in range(20_000)])
    for learner, expected in enumerate((0.1, 0.3, 0.6)):
        tolerance = 5 * math.sqrt(expected * (1 - expected) / 20_000)
        assert abs(float(np.mean(draws == learner)) - expected) <= tolerance


def test_apel_probability_is_one_draw_from_the_dirichlet() -> None:
    """The recorded probability is the vector drawn for this episode, another one each time."""
    clock = Clock(Apel(), 3)
    vectors = set()
    for _ in range(50):
        clock.select()
        vectors.add(tuple(clock.probability))
    assert len(vectors) == 50


def test_apel_prior_is_the_initial_concentration() -> None:
    """A prior stands in the state before the first episode, and is refused for another number of learners."""
    apel = Apel(prior=(2.0, 1.0, 5.5))
    assert apel.initial_state(3, 10)[6:].tolist() == [2.0, 1.0, 5.5]
    with pytest.raises(ValueError, match="prior: found 3 concentrations, expected one per learner, 2"):
        apel.initial_state(2, 10)


@pytest.mark.parametrize(
    "options",
    [
        {"decay": 1.0},
        {"decay": -0.001},
        {"decay": math.nan},
        {"decay": math.inf},
        {"decay": "fast"},
        {"temperature": 0.1},
        {"prior": (0.999, 1.0)},
        {"prior": (math.nan, 1.0)},
        {"prior": 2.0},
    ],
)
def test_apel_refuses_options_out_of_range(options: dict[str, object]) -> None:
    """ν lies in [0, 1), priors are at least 1, and unknown options are refused; the message names the option."""
    with pytest.raises(ValueError, match=next(iter(options))):
        Apel(**options)


# SSBAS


def test_ssbas_golden_trace() -> None:
    """UCB1 over the last ⌊τ/2⌋ selections by hand, ξ = 1: missing learners first, then mean plus bonus."""
    clock = Clock(Ssbas(exploration=1.0), 2)
    trace = [
        # probabilities before the episode, selected, performance
        ((0.5, 0.5), 0, 3.0),  # τ = 0: an empty window
        ((0.5, 0.5), 0, 1.0),  # τ = 1: still empty
        ((0.0, 1.0), 1, 2.0),  # τ = 2: the window holds 0, so that 1 is missing
        ((1.0, 0.0), 0, 5.0),  # τ = 3: it holds 1 alone
        ((1.0, 0.0), 0, 5.0),  # τ = 4: 1 (2.0), 0 (5.0): equal counts, so the mean decides
        ((0.0, 1.0), 1, 4.9),  # τ = 5: 0, 0
        # τ = 6: 0 (5), 0 (5), 1 (4.9): 5 + √(ln 3 / 2) = 5.741 < 4.9 + √(ln 3) = 5.948
        ((0.0, 1.0), 1, 4.9),
        # τ = 7: 0 (5), 1 (4.9), 1 (4.9): 6.048 > 5.641
        ((1.0, 0.0), 0, 4.8),
        # τ = 8: 0 (5), 1, 1 (4.9), 0 (4.8): both means are 4.9, both counts 2: (5 + 4.8) / 2 = (4.9 + 4.9) / 2
        ((0.5, 0.5), 1, 0.0),
        # τ = 9: 1, 1 (4.9), 0 (4.8), 1 (0): 4.8 + √(ln 4) = 5.977 > 9.8 / 3 + √(ln 4 / 3) = 3.946
        ((1.0, 0.0), 0, 1.0),
    ]
    for expected, selected, performance in trace:
        clock.select()
        assert clock.probability == pytest.approx(expected, abs=1e-12)
        clock.observe(selected, performance)


def ssbas_oracle(history: Sequence[tuple[int, int]], num_learners: int, exploration: float) -> set[int]:
    """The learners of the largest index, everything worked out afresh from the whole history."""
    size = len(history) // 2
    window = history[len(history) - size :]
    played = [[performance for learner, performance in window if learner == k] for k in range(num_learners)]
    missing = {k for k in range(num_learners) if not played[k]}
    if missing:
        return missing
    index = [sum(p) / len(p) + math.sqrt(exploration * math.log(size) / len(p)) for p in played]
    return {k for k in range(num_learners) if index[k] == max(index)}


@settings(max_examples=20)
@given(
    num_learners=st.integers(1, 4),
    exploration=st.sampled_from([0.25, 1.0, 4.921, 100.0]),
    spread=st.sampled_from([0, 1, 3, 100]),
    seed=st.integers(0, 2**32),
)
def test_ssbas_agrees_with_brute_force(num_learners: int, exploration: float, spread: int, seed: int) -> None:
    """Over hundreds of episodes the O(1) window gives the very argmax set that the whole history gives.

    Performances are whole numbers, so that sums are exact and ties real.
    """
    draw = random.Random(seed)
    clock = Clock(Ssbas(exploration=exploration), num_learners, num_episodes=400, seed=seed)
    history: list[tuple[int, int]] = []
    for _ in range(400):
        expected = ssbas_oracle(history, num_learners, exploration)
        selected = clock.select()
        assert {k for k in range(num_learners) if clock.probability[k] > 0.0} == expected
        assert all(p in (0.0, 1 / len(expected)) for p in clock.probability)
        assert selected in expected
        performance = draw.randint(-spread, spread)
        clock.observe(selected, float(performance))
        history.append((selected, performance))


@pytest.mark.parametrize("num_learners", [2, 3])
def test_ssbas_tries_every_learner_once_per_doubling(num_learners: int) -> None:
    """A learner last tried at s has left the window at τ = 2 s + 1, and is then taken, however bad it is.

    Several that leave together take turns, one episode each. Gaps also come close to that bound: they grow with τ.
    """
    clock = Clock(Ssbas(), num_learners, num_episodes=5_000)
    last: dict[int, int] = {}
    gaps = []
    for episode in range(5_000):
        selected = clock.select()
        if selected in last and last[selected] >= num_learners:
            assert episode <= 2 * last[selected] + num_learners - 1
            gaps.append(episode - last[selected])
        last[selected] = episode
        clock.observe(selected, 0.0 if selected == 0 else -100.0)
    assert max(gaps) > 1_000


def test_ssbas_breaks_ties_evenly() -> None:
    """Missing learners are drawn with equal chances."""
    clock = Clock(Ssbas(), 3, seed=9)
    draws = np.array([clock.select() for _ in range(9_000)])
    for learner in range(3):
        assert abs(float(np.mean(draws == learner)) - 1 / 3) <= 5 * math.sqrt(2 / 9 / 9_000)


def test_ssbas_does_not_normalise_performances() -> None:
    """The bonus is not scaled to the performances: at a gap of 97 it cannot make up for the mean."""
    clock = Clock(Ssbas(), 2, num_episodes=100)
    for selected, performance in [(0, -3.0)] * 40 + [(1, -100.0)] + [(0, -3.0)] * 5:
        clock.observe(selected, performance)
    clock.select()
    # 1's index: −100 + √(4.921 · ln 23 / 1) = −96.1.
    assert clock.probability == [1.0, 0.0]


@pytest.mark.parametrize("options", [{"exploration": 0.0}, {"exploration": math.nan}, {"xi": 1.0}])
def test_ssbas_refuses_options_out_of_range(options: dict[str, float]) -> None:
    """ξ is positive and finite, and unknown options are refused."""
    with pytest.raises(ValueError, match=next(iter(options))):
        Ssbas(**options)


# The selectors that learn nothing


def test_uniform_selects_all_alike() -> None:
    """Each of n learners is selected with probability 1/n, whatever they achieve."""
    clock = Clock(Uniform(), 4, seed=1)
    draws = []
    for _ in range(20_000):
        selected = clock.select()
        clock.observe(selected, float(selected))
        draws.append(selected)
    assert clock.probability == [0.25] * 4
    for learner in range(4):
        assert abs(draws.count(learner) / 20_000 - 0.25) <= 5 * math.sqrt(0.25 * 0.75 / 20_000)


def test_fixed_always_selects_its_learner() -> None:
    """The named learner has probability 1, also after bad performances."""
    clock = Clock(Fixed(learner=2), 3)
    for _ in range(20):
        assert clock.select() == 2
        clock.observe(2, -1.0)
    assert clock.probability == [0.0, 0.0, 1.0]


def test_fixed_refuses_a_learner_that_is_not_there() -> None:
    """A position beyond the learners is refused when the state is made, a negative one at once."""
    with pytest.raises(ValueError, match="learner: found 3, expected a position from 0 to 2"):
        Fixed(learner=3).initial_state(3, 10)
    with pytest.raises(ValueError, match="learner"):
        Fixed(learner=-1)


def test_selectors_draw_nothing_but_their_stream() -> None:
    """Two runs of one selector with equal streams and performances are equal, value for value."""
    for selector in SHIPPED:
        one, two = Clock(selector, 3, seed=8), Clock(selector, 3, seed=8)
        for episode in range(200):
            selected = one.select()
            assert two.select() == selected
            for clock in (one, two):
                clock.observe(selected, math.sin(episode))
        np.testing.assert_array_equal(one.state, two.state)
        np.testing.assert_array_equal(one.stream, two.stream)


def test_function_compiled_for_its_address_can_still_be_called(tmp_path: Path) -> None:
    """Whichever of the two forms of a kernel function is compiled, and cached, first: the other works."""
    use = (
        "import apel; s = apel.Apel(); state = s.initial_state(2, 10); s.observe.__wrapper_address__();"
        "s.observe(s.parameters(), 2, state, 0, 1.0); assert state[2] == 1.0"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    assert subprocess.run([sys.executable, "-c", use], env=environment, check=False).returncode == 0
