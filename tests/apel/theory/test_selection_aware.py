"""The model in which only the selected learner gains, against its recursions, its exact chain, and the selector."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apel.numerics.streams import stream_of_seed
from apel.run.selection import common_blocks
from apel.selectors import Apel
from apel.theory import closed_forms, curves, exact
from apel.theory import selection_aware as aware
from apel.theory.adaptation import AdaptationTimes, WindowCriterion, adaptation_time_distribution
from apel.theory.chains import make_chains

# The steady state


@given(nu=st.floats(1e-5, 0.9), num_learners=st.integers(2, 20))
def test_steady_state_is_the_fixed_point(nu: float, num_learners: int) -> None:
    """One mean-field step leaves c* where it is, also at the floor; below it lies Eq. 3.9."""
    steady = aware.steady_state_concentration(nu, num_learners)
    start = [steady] + [1.0] * (num_learners - 1)
    np.testing.assert_allclose(aware.expected_concentrations(nu, start, 1)[1], start, rtol=1e-9)
    assert steady <= closed_forms.steady_state_concentration(nu)
    assert aware.exploration_probability(nu, num_learners) >= closed_forms.exploration_probability(nu, num_learners)


@pytest.mark.parametrize(("nu", "num_learners", "expected"), [(0.01, 2, 98 / 99), (0.1, 5, 5 / 9), (0.25, 3, 1 / 3)])
def test_selection_probability(nu: float, num_learners: int, expected: float) -> None:
    """(1 − n ν) / (1 − ν), down to 1/n at ν = 1/(n + 1), and 1/n beyond."""
    assert aware.selection_probability(nu, num_learners) == pytest.approx(expected)
    assert aware.selection_probability(0.4, num_learners) == 1.0 / num_learners


def test_steady_state_performance() -> None:
    """Two learners: G* − (G* − G) ν / (1 − ν): −2.3 − 97.7 / 99 = −3.28687."""
    assert aware.steady_state_performance(0.01, -2.3, [-100.0]) == pytest.approx(-3.2868687, abs=1e-7)


# Times


def test_expected_concentrations_by_hand() -> None:
    """ν = 0.1 from (1, 1): (1 + 1/2) 0.9 = 1.35; (1.35 + 1.35/2.35) 0.9 = 1.7320. Without decay: 1, 1.5, 2.1."""
    np.testing.assert_allclose(aware.expected_concentrations(0.1, [1.0, 1.0], 2)[:, 0], [1.0, 1.35, 1.73202], atol=1e-5)
    np.testing.assert_allclose(curves.selection_aware_growth(0.0, 2), [1.0, 1.5, 2.1])
    np.testing.assert_allclose(aware.expected_concentrations(0.5, [9.0, 1.0], 1, best=1)[1], [4.5, 1.0])


@pytest.mark.parametrize("nu", [0.002, 0.05, 0.2])
def test_discovery_time_of_two_learners(nu: float) -> None:
    """The mean wait is Σ P(not selected in k episodes), each factor 1 − 1 / (c_k + 1) with c_k by Eq. 3.7 from c*."""
    steady, limit = 1 / nu - 2, 1 / nu - 1
    waiting, expected = 1.0, 0.0
    for k in range(int(40 / nu)):
        expected += waiting
        waiting *= 1.0 - 1.0 / (limit + (1 - nu) ** k * (steady - limit) + 1.0)
    assert aware.discovery_time(nu, 2) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("num_learners", [2, 5])
@pytest.mark.parametrize("nu", [0.002, 0.02, 0.1])
def test_slower_than_the_dissertation(nu: float, num_learners: int) -> None:
    """Whoever must be selected to gain rises later and adapts later."""
    assert aware.rise_time(nu, num_learners) > closed_forms.rise_time(nu)
    assert aware.adaptation_time(nu, num_learners) > 2 * closed_forms.adaptation_time(nu)


def test_nothing_rises_beyond_the_range() -> None:
    """At ν ≥ 1/(n + 1) all rest at 1."""
    assert aware.adaptation_time(0.25, 3) == aware.rise_time(0.25, 3) == 0.0


@pytest.mark.parametrize(("nu", "num_learners"), [(0.1, 2), (0.02, 2), (0.02, 5), (0.01, 20)])
def test_expected_adaptation_time_is_near_the_simulated_mean(nu: float, num_learners: int) -> None:
    """The mean field is 0 to 10 % short of the chains' mean, whose standard error is below 2 % here."""
    times = adaptation_time_distribution(nu, num_learners, num_chains=600, seed=3)
    assert times.num_censored == 0
    assert 0.96 < times.mean / aware.adaptation_time(nu, num_learners) < 1.12


# The exact chain


def test_exact_by_hand() -> None:
    """ν = 1/4, two learners, from (2, 1), by hand.

    k = 1: learner 1 is selected with 1/3: (1.5, 1.5), crossed; else (2.25, 1). k = 2: with 1/3.25: (1.6875, 1.5); else
    (2.4375, 1). k = 3: from the first, learner 1 with 1.5/3.1875: (1.27, 1.88), crossed; from the second it gets to 1.5
    against 1.83. In all 1/3 + 2/3 · 1/3.25 · 1.5/3.1875 = 0.429864.
    """
    np.testing.assert_allclose(
        exact.crossing_distribution(0.25, 2, 3), [0.0, 1 / 3, 1 / 3, 1 / 3 + 2 / 3 / 3.25 * 1.5 / 3.1875], rtol=1e-12
    )


@pytest.mark.parametrize(("nu", "num_learners", "horizon"), [(0.1, 2, 60), (0.2, 2, 40), (0.15, 4, 16), (0.05, 2, 18)])
def test_simulation_agrees_with_the_exact_chain(nu: float, num_learners: int, horizon: int) -> None:
    """The simulated distribution lies within 0.03 of the exact one.

    By the Dvoretzky–Kiefer–Wolfowitz inequality 4000 chains miss that with a probability below 2 e^(−7.2) = 0.0015.
    """
    expected = exact.crossing_distribution(nu, num_learners, horizon)
    assert np.all(np.diff(expected) >= 0.0)
    times = adaptation_time_distribution(nu, num_learners, num_chains=4000, max_episodes=horizon, seed=1)
    simulated = (times.episodes[:, None] <= np.arange(horizon + 1)).mean(axis=0)
    assert np.abs(simulated - expected).max() < 0.03


def test_exact_chain_loses_nothing() -> None:
    """With two learners at ν = 0.2 the whole distribution is within reach: it sums to 1."""
    assert exact.crossing_distribution(0.2, 2, 200)[-1] == pytest.approx(1.0, abs=1e-12)


def test_exact_chain_has_an_end() -> None:
    """Too many states are an error that says how far one got."""
    with pytest.raises(ValueError, match=r"horizon: found .* states after .* episodes, expected at most 1000"):
        exact.crossing_distribution(0.01, 3, 50, max_states=1000)


# The measured criterion


def test_measured_criterion_waits_for_its_window() -> None:
    """It is met at the window's end at the earliest, and the crossing comes before it on average."""
    criterion = WindowCriterion([34 * 1.67, 34.0], threshold=37.4, window=50)
    measured = adaptation_time_distribution(0.1, criterion=criterion, num_chains=500)
    assert measured.episodes.min() >= 50.0
    assert measured.mean > adaptation_time_distribution(0.1, num_chains=500).mean


def test_measured_criterion_with_observed_lengths() -> None:
    """An array of equal observed lengths is a constant; the selections do not depend on lengths at all."""
    constant = WindowCriterion([50.0, 30.0], threshold=33.0, window=20)
    observed = WindowCriterion([[50.0, 50.0], [30.0] * 3], threshold=33.0, window=20)
    one, two = (adaptation_time_distribution(0.05, criterion=c, num_chains=100) for c in (constant, observed))
    np.testing.assert_array_equal(one.episodes, two.episodes)
    noisy = WindowCriterion([[40.0, 60.0], [20.0, 40.0]], threshold=33.0, window=20)
    assert np.isfinite(adaptation_time_distribution(0.05, criterion=noisy, num_chains=100).mean)


def test_criterion_out_of_reach_is_censored() -> None:
    """A threshold below the good learner's own length is never met: infinite times, counted as censored."""
    times = adaptation_time_distribution(
        0.1, criterion=WindowCriterion([50.0, 30.0], 29.0, window=5), num_chains=7, max_episodes=40
    )
    assert times.num_censored == 7
    assert times.mean == math.inf
    assert math.isnan(times.standard_deviation)


def test_switch_after_some_episodes() -> None:
    """A switch at an episode long past the rise is a switch at the steady state; without decay it takes far longer."""
    settled = adaptation_time_distribution(0.1, num_chains=1500).mean
    assert adaptation_time_distribution(0.1, num_chains=1500, switch_episode=200).mean == pytest.approx(
        settled, rel=0.1
    )
    undecayed = adaptation_time_distribution(0.0, num_chains=50, switch_episode=200, max_episodes=300)
    assert undecayed.num_censored > 25
    with pytest.raises(ValueError, match=r"nu: found 0.0, expected above 0, or a switch_episode and max_episodes"):
        adaptation_time_distribution(0.0)


def test_quantiles_keep_censored_chains() -> None:
    """Quantiles are values that occurred, infinite ones included."""
    times = AdaptationTimes(np.array([3.0, 1.0, math.inf, 2.0]))
    assert times.quantile([0.25, 0.5, 0.75, 1.0]).tolist() == [1.0, 2.0, 3.0, math.inf]


@pytest.mark.parametrize(
    ("lengths", "window", "message"),
    [
        ([1.0], 5, "lengths: found 1, expected one per learner, 2"),
        ([1.0, math.nan], 5, "lengths: found an empty array or a number that is not finite"),
        ([1.0, []], 5, "lengths: found an empty array"),
        ([1.0, 2.0], 0, "window: found 0, expected 1 or more"),
    ],
)
def test_bad_criterion(lengths: list[float], window: int, message: str) -> None:
    """A criterion that makes no sense is refused."""
    with pytest.raises(ValueError, match=message):
        adaptation_time_distribution(0.1, criterion=WindowCriterion(lengths, 3.0, window), num_chains=2)


def test_bad_chains() -> None:
    """Starts out of range are refused."""
    with pytest.raises(ValueError, match="concentration: found 1 values, expected one per learner, 2"):
        make_chains(0.1, [1.0, 0.0], 5, concentration=[1.0])
    with pytest.raises(ValueError, match="expected each to be at least 1"):
        make_chains(0.1, [1.0, 0.0], 5, concentration=[1.0, 0.5])


# The selector itself


class Play:
    """The compiled selector against fixed performances."""

    def __init__(self, nu: float, num_learners: int, seed: int) -> None:
        self.apel, self.num_learners = Apel(decay=nu), num_learners
        self.parameters = self.apel.parameters()
        self.state = self.apel.initial_state(num_learners, 1)
        self.stream = stream_of_seed(seed)

    def settle(self, steady: float) -> None:
        state, others = common_blocks(self.state, self.num_learners), self.num_learners - 1
        state.performance_estimate[:] = [1.0] + [0.0] * others
        state.concentration[:] = [steady] + [1.0] * others

    def episode(self, performances: list[float]) -> int:
        selected = self.apel.select(self.parameters, self.num_learners, self.state, self.stream)
        self.apel.observe(self.parameters, self.num_learners, self.state, selected, performances[selected])
        return selected

    @property
    def concentration(self) -> list[float]:
        return common_blocks(self.state, self.num_learners).concentration.tolist()


@pytest.mark.parametrize(
    ("nu", "num_learners", "tolerance"),
    # The concentration is correlated over about 1/ν of the 12 000 episodes. What c* neglects shows at ν = 0.1.
    [(0.01, 2, 0.02), (0.02, 5, 0.03), (0.1, 2, 0.08)],
)
def test_steady_state_of_the_selector(nu: float, num_learners: int, tolerance: float) -> None:
    """In play the best learner's concentration is 1/ν − n and it is selected with (1 − n ν) / (1 − ν)."""
    play = Play(nu, num_learners, seed=11)
    performances = [1.0] + [0.0] * (num_learners - 1)
    play.settle(aware.steady_state_concentration(nu, num_learners))
    selected, concentration = [], []
    for _ in range(12_000):
        selected.append(play.episode(performances) == 0)
        concentration.append(play.concentration[0])
    assert np.mean(concentration) == pytest.approx(aware.steady_state_concentration(nu, num_learners), rel=tolerance)
    assert np.mean(selected) == pytest.approx(aware.selection_probability(nu, num_learners), abs=0.012)


@pytest.mark.parametrize(("nu", "num_learners"), [(0.05, 2), (0.1, 4)])
def test_crossing_of_the_selector(nu: float, num_learners: int) -> None:
    """From the same settled start the selector's crossing times have the distribution of the theory's chains.

    600 plays: a Kolmogorov–Smirnov distance of 0.09 has a probability below 1e-4.
    """
    times = []
    for seed in range(600):
        play = Play(nu, num_learners, seed)
        play.settle(aware.steady_state_concentration(nu, num_learners))
        k = 0
        while play.concentration[1] < play.concentration[0]:
            play.episode([1.0, 2.0] + [0.0] * (num_learners - 2))
            k += 1
        times.append(k)
    simulated = adaptation_time_distribution(nu, num_learners, num_chains=6000, seed=5).episodes
    grid = np.arange(400)
    distance = (np.array(times)[:, None] <= grid).mean(axis=0) - (simulated[:, None] <= grid).mean(axis=0)
    assert np.abs(distance).max() < 0.09
