"""Noise and floor: the simulated chains against mean fields where there are some, and against the selector itself."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest
from numpy.typing import NDArray

from apel.numerics.compiled import njit
from apel.numerics.streams import stream_of_seed
from apel.run.selection import Observe, Select, common_blocks
from apel.selectors import Apel
from apel.theory import selection_aware
from apel.theory.noisy import LEAST_DECAY, Noisy, adaptation_time, decay_for, rise_time, steady_state

RUNS = 100


@njit
def _play(select: Select, observe: Observe, parameters, row, stream, table, found):  # type: ignore[no-untyped-def]
    """Play a run over ``float64[learners, episodes]``; adds its late half's concentrations and probabilities of 0."""
    num_learners, num_episodes = table.shape
    for episode in range(num_episodes):
        selected = select(parameters, num_learners, row, stream)
        if 2 * episode >= num_episodes:
            state = common_blocks(row, num_learners)
            found[0] += state.concentration[0] / (num_episodes // 2)
            found[1] += state.concentration[0] / state.concentration.sum() / (num_episodes // 2)
        observe(parameters, num_learners, row, selected, table[selected, episode])


def measured(nu: float, num_learners: int, win_probability: float) -> NDArray[np.float64]:
    """``float64[2]``: concentration and probability of the best, by APEL's own selector, 100 runs of 60/ν episodes."""
    selector, found, draws = Apel(decay=nu), np.zeros(2), np.random.default_rng(5)
    lead = 50.0 if win_probability == 1.0 else math.sqrt(2.0) * NormalDist().inv_cdf(win_probability)
    for run in range(RUNS):
        table = draws.standard_normal((num_learners, math.ceil(60 / nu)))
        table[0] += lead
        row = selector.initial_state(num_learners, table.shape[1])
        stream = stream_of_seed(1000 + run)
        _play(selector.select, selector.observe, selector.parameters(), row, stream, table, found)
    return found / RUNS


@pytest.mark.parametrize("win_probability", [0.6, 0.8, 1.0])
@pytest.mark.parametrize("num_learners", [2, 5])
@pytest.mark.parametrize("nu", [0.003, 0.02, 0.1])
def test_selector_settles_as_predicted(nu: float, num_learners: int, win_probability: float) -> None:
    """Within 10 % of 100 runs: the best one's concentration, and the share of the episodes of all others."""
    concentration, probability = measured(nu, num_learners, win_probability)
    predicted = steady_state(nu, Noisy(num_learners, win_probability))
    assert predicted.concentration == pytest.approx(concentration, rel=0.1)
    assert predicted.exploration_probability == pytest.approx(1.0 - probability, rel=0.1)


def test_numbers_of_today() -> None:
    """5 % were promised for n = 4 by the closed form; at win probabilities of .7 and .8 it was 12.0 and 8.6 %."""
    nu = 0.05 / (3 + 0.05)
    assert selection_aware.exploration_probability(nu, 4) == pytest.approx(0.05)
    shares = [steady_state(nu, Noisy(4, p)).exploration_probability for p in (0.7, 0.8)]
    assert shares == pytest.approx([0.120, 0.086], rel=0.03)


@pytest.mark.parametrize("nu", [0.005, 0.05])
def test_mean_field_without_noise(nu: float) -> None:
    """With p = 1 and ρ = 0 it is the selection-aware model, whose times are a few percent short."""
    found = steady_state(nu, Noisy(3))
    assert found.concentration == pytest.approx(selection_aware.steady_state_concentration(nu, 3), rel=0.01)
    assert found.exploration_probability == pytest.approx(selection_aware.exploration_probability(nu, 3), rel=0.02)
    assert adaptation_time(nu, Noisy(3)) == pytest.approx(selection_aware.adaptation_time(nu, 3), rel=0.08)
    assert rise_time(nu, Noisy(3)) == pytest.approx(selection_aware.rise_time(nu, 3), rel=0.1)


@pytest.mark.parametrize("floor", [0.05, 0.2])
def test_mean_field_with_a_floor(floor: float) -> None:
    """Without noise: c = (c + P)(1 − ν) with P = (1 − nρ) c / (c + n − 1) + ρ, solved by iteration."""
    nu, count = 0.01, 3
    concentration = probability = 1.0
    for _ in range(5000):
        probability = (1 - count * floor) * concentration / (concentration + count - 1) + floor
        concentration = max((concentration + probability) * (1 - nu), 1.0)
    found = steady_state(nu, Noisy(count, floor=floor))
    assert found.concentration == pytest.approx(concentration, rel=0.02)
    assert found.exploration_probability == pytest.approx(1 - probability, rel=0.02)


def test_decay_that_is_wanted() -> None:
    """It gives what is wanted of it, and equal seeds the same ν; what no ν gives is refused."""
    ensemble = Noisy(3, 0.8, 0.05)

    def explored(nu: float) -> float:
        return steady_state(nu, ensemble).exploration_probability

    nu = decay_for(explored, 0.2, 3, rising=True)
    assert nu == decay_for(explored, 0.2, 3, rising=True)
    assert explored(nu) == pytest.approx(0.2, rel=0.01)
    with pytest.raises(ValueError, match=rf"found 0.05, expected 0.1.* from ν = {LEAST_DECAY:g} to 0.25"):
        decay_for(explored, 0.05, 3, rising=True)


def test_decay_by_any_measure() -> None:
    """Of a measure known by formula: from infinite, to zero, to negative ones, and to either end of the range; once
    at 0.1 the largest ν for n = 9.
    """
    for measure, wanted, nu in (
        (lambda nu: 3.0 / nu if nu > 0.01 else math.inf, 100.0, 0.03),
        (lambda nu: 1.0 / nu - 10.0, 40.0, 0.02),  # 0 at the top
        (lambda nu: 1.0 - 20.0 * nu, 0.5, 0.025),  # −1 there
        (lambda nu: 3.0 / nu, 3.0 / LEAST_DECAY, LEAST_DECAY),
        (lambda nu: 3.0 / nu, 30.0, 0.1),
        (lambda nu: 0.5 - 20.0 * nu, 0.0, 0.025),
        (lambda nu: -10.0 - 900.0 * nu, -20.0, 1.0 / 90.0),
    ):
        assert decay_for(measure, wanted, 9, rising=False) == pytest.approx(nu, rel=2e-3)
    assert decay_for(lambda nu: 2.0 * nu, 0.01, 9, rising=True) == pytest.approx(0.005, rel=2e-3)
    with pytest.raises(ValueError, match=r"found 29, expected 30 to 6000, from ν = 0\.0005 to 0\.1"):
        decay_for(lambda nu: 3.0 / nu, 29.0, 9, rising=False)
    with pytest.raises(ValueError, match=r"found 0\.3, expected 0\.001 to 0\.2, from ν = 0\.0005 to 0\.1"):
        decay_for(lambda nu: 2.0 * nu, 0.3, 9, rising=True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1,), "num_learners: found 1"),
        ((2, 0.5), "win_probability: found 0.5, expected above 0.5"),
        ((2, 1.1), "win_probability: found 1.1"),
        ((4, 0.9, 0.25), "floor: found 0.25, expected at least 0 and below 1/n = 0.25"),
        ((4, 0.9, -0.1), "floor: found -0.1"),
        ((4, float("nan")), "win_probability: found nan"),
    ],
)
def test_what_is_refused(arguments: tuple[float, ...], message: str) -> None:
    """One learner, a best that is not, a floor above a uniform choice."""
    with pytest.raises(ValueError, match=message):
        Noisy(*arguments)  # type: ignore[arg-type]
