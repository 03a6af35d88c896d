"""Each inverse undoes its formula, and refuses what no ν can give."""

from __future__ import annotations

import math
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from apel.theory import closed_forms, inverses, selection_aware, selection_aware_inverses

TIMES = st.floats(0.01, 1e5)
LEARNERS = st.integers(2, 20)
BOTH = pytest.mark.parametrize(
    ("forms", "undo"),
    [(closed_forms, inverses), (selection_aware, selection_aware_inverses)],
    ids=["dissertation", "selection-aware"],
)


@given(episodes=TIMES, fraction=st.floats(0.05, 0.99))
def test_times_of_the_dissertation(episodes: float, fraction: float) -> None:
    """ν from a time gives that time (Eq. 3.11, 3.12)."""
    assert closed_forms.adaptation_time(inverses.decay_for_adaptation_time(episodes)) == pytest.approx(episodes)
    nu = inverses.decay_for_rise_time(episodes, fraction)
    assert closed_forms.rise_time(nu, fraction) == pytest.approx(episodes, rel=1e-6)


@given(nu=st.floats(1e-5, 0.45))
def test_decay_of_the_dissertation(nu: float) -> None:
    """A time gives back the ν that it came from."""
    assert inverses.decay_for_adaptation_time(closed_forms.adaptation_time(nu)) == pytest.approx(nu, rel=1e-6)
    assert inverses.decay_for_rise_time(closed_forms.rise_time(nu)) == pytest.approx(nu, rel=1e-6)


@hypothesis_settings(max_examples=25)
@given(episodes=st.floats(20.0, 1000.0), num_learners=LEARNERS)
def test_times_of_the_selection_aware_model(episodes: float, num_learners: int) -> None:
    """ν from a time gives that time, and a smaller ν takes longer."""
    for undo, time in (
        (selection_aware_inverses.decay_for_adaptation_time, selection_aware.adaptation_time),
        (selection_aware_inverses.decay_for_rise_time, selection_aware.rise_time),
    ):
        nu = undo(episodes, num_learners)
        assert 0.0 < nu <= 1.0 / (num_learners + 1)
        assert time(nu, num_learners) == pytest.approx(episodes, rel=1e-4)
        assert time(0.9 * nu, num_learners) > episodes


@BOTH
@given(nu=st.floats(1e-6, 0.9), num_learners=LEARNERS)
def test_probabilities(forms: ModuleType, undo: ModuleType, nu: float, num_learners: int) -> None:
    """ν from a probability is the ν that it came from, or the smallest at which the best keeps no lead."""
    largest = 0.5 if forms is closed_forms else 1.0 / (num_learners + 1)
    explored = forms.exploration_probability(nu, num_learners)
    assert undo.decay_for_exploration(explored, num_learners) == pytest.approx(min(nu, largest), rel=1e-9)
    probability = max(forms.selection_probability(nu, num_learners), 1.0 / num_learners)
    found = undo.decay_for_selection_probability(probability, num_learners)
    assert found == pytest.approx(min(nu, largest), rel=1e-6)


@BOTH
@given(nu=st.floats(1e-4, 0.04), best=st.floats(-10, 10), gaps=st.lists(st.floats(0.1, 100), min_size=1, max_size=20))
def test_performances(forms: ModuleType, undo: ModuleType, nu: float, best: float, gaps: list[float]) -> None:
    """ν from a performance is the ν that it came from (Eq. 3.15, and its counterpart)."""
    others = [best - gap for gap in gaps]
    performance = forms.steady_state_performance(nu, best, others)
    assert undo.decay_for_performance(performance, best, others) == pytest.approx(nu, rel=1e-6)


def test_golden_numbers() -> None:
    """Worked by hand.

    Eq. 3.13 with μ = 0.9, n = 3: 0.1 / 1.9; the other: 0.1 / (3 − 0.9). Eq. 3.15 with G* = 1, others 0 and −1, and
    E[G] = 0.6: 0.4 / (1 + 0.6 + 1) = 0.4 / 2.6; the other: 0.4 / (0.4 + 3).
    """
    assert inverses.decay_for_selection_probability(0.9, 3) == pytest.approx(0.1 / 1.9)
    assert selection_aware_inverses.decay_for_selection_probability(0.9, 3) == pytest.approx(0.1 / 2.1)
    assert inverses.decay_for_performance(0.6, 1.0, [0.0, -1.0]) == pytest.approx(0.4 / 2.6)
    assert selection_aware_inverses.decay_for_performance(0.6, 1.0, [0.0, -1.0]) == pytest.approx(0.4 / 3.4)


@BOTH
@pytest.mark.parametrize("exploration", [0.0, -0.1, 0.67, 1.0, math.nan])
def test_exploration_out_of_reach(forms: ModuleType, undo: ModuleType, exploration: float) -> None:
    """Three learners explore with a probability in (0, 2/3]."""
    with pytest.raises(ValueError, match=r"exploration: found .*, expected above 0 and at most \(n - 1\)/n = 0.666667"):
        undo.decay_for_exploration(exploration, 3)
    with pytest.raises(ValueError, match=r"probability: found .*, expected at least 1/n"):
        undo.decay_for_selection_probability(1.0 - exploration, 3)


@BOTH
@pytest.mark.parametrize("performance", [-1.1, 1.0, 2.0, math.nan])
def test_performance_out_of_reach(forms: ModuleType, undo: ModuleType, performance: float) -> None:
    """With returns 1 and −3 a mean return lies in [−1, 1)."""
    with pytest.raises(ValueError, match=r"performance: found .*, expected at least -1, .* below the best return, 1"):
        undo.decay_for_performance(performance, 1.0, [-3.0])


@pytest.mark.parametrize("episodes", [0.0, -5.0, math.nan, math.inf])
def test_time_out_of_range(episodes: float) -> None:
    """A time is a finite number above 0."""
    for undo in (inverses.decay_for_adaptation_time, inverses.decay_for_rise_time):
        with pytest.raises(ValueError, match="episodes: found"):
            undo(episodes)
    for aware in (selection_aware_inverses.decay_for_adaptation_time, selection_aware_inverses.decay_for_rise_time):
        with pytest.raises(ValueError, match="episodes: found"):
            aware(episodes, 2)


def test_adaptation_faster_than_chance() -> None:
    """Twenty learners: the new best is first selected after about 20 episodes, and no ν is faster."""
    with pytest.raises(ValueError, match=r"episodes: found 5, expected at least 19.1: no decay is faster"):
        selection_aware_inverses.decay_for_adaptation_time(5.0, 20)
