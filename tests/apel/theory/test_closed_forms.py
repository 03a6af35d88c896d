"""The dissertation's closed forms, against numbers worked by hand and against the recursions they solve."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apel.theory import closed_forms as forms
from apel.theory import curves

DECAYS = st.floats(1e-4, 0.999)


def test_dirichlet_moments() -> None:
    """Eq. 3.1 for c = (3, 1): mean 3/4, variance (3/4 · 1/4) / 5 = 0.0375; rows are taken one by one."""
    np.testing.assert_allclose(forms.dirichlet_mean([[3.0, 1.0], [1.0, 1.0]]), [[0.75, 0.25], [0.5, 0.5]])
    np.testing.assert_allclose(forms.dirichlet_variance([[3.0, 1.0], [1.0, 1.0]])[:, 0], [0.0375, 0.25 / 3])


def test_dirichlet_moments_are_those_of_draws() -> None:
    """They are the moments of Dirichlet draws."""
    draws = np.random.default_rng(1).dirichlet([5.0, 2.0, 1.0], size=40_000)
    np.testing.assert_allclose(forms.dirichlet_mean([5.0, 2.0, 1.0]), draws.mean(axis=0), atol=0.005)
    np.testing.assert_allclose(forms.dirichlet_variance([5.0, 2.0, 1.0]), draws.var(axis=0), rtol=0.05)


@pytest.mark.parametrize(("nu", "expected"), [(0.001, 999.0), (0.01, 99.0), (0.1, 9.0), (0.5, 1.0), (0.8, 1.0)])
def test_steady_state(nu: float, expected: float) -> None:
    """Eq. 3.9: 1/ν − 1; from ν = 1/2 on the floor."""
    assert forms.steady_state_concentration(nu) == pytest.approx(expected, rel=1e-12)


def test_growth_by_hand() -> None:
    """Eq. 3.6 at ν = 0.1: 1, (1 + 1) 0.9 = 1.8, (1.8 + 1) 0.9 = 2.52, 3.168; without decay 1, 2, 3."""
    np.testing.assert_allclose(forms.incremented_concentration(0.1, range(4)), [1.0, 1.8, 2.52, 3.168])
    np.testing.assert_allclose(forms.incremented_concentration(0.0, range(3)), [1.0, 2.0, 3.0])


@given(nu=DECAYS, initial=st.floats(1.0, 50.0))
def test_growth_solves_the_recursion(nu: float, initial: float) -> None:
    """The closed form is the recursion of Eq. 3.6 with the floor of Eq. 3.5, and the sum of Eq. 3.7 above it."""
    closed = forms.incremented_concentration(nu, np.arange(60), initial)
    concentration = initial
    for k in range(60):
        assert closed[k] == pytest.approx(concentration, rel=1e-9)
        printed = (1 - nu) ** k * (initial + 1) + sum((1 - nu) ** i for i in range(1, k))
        assert k == 0 or closed[k] == pytest.approx(max(printed, 1.0), rel=1e-9)
        concentration = max((concentration + 1) * (1 - nu), 1.0)


@given(nu=st.floats(0.0, 0.999), initial=st.floats(1.0, 1e3))
def test_decay_solves_the_recursion(nu: float, initial: float) -> None:
    """Eq. 3.10, second line, is Eq. 3.5 applied again and again."""
    closed = forms.decayed_concentration(nu, np.arange(50), initial)
    concentration = initial
    for k in range(50):
        assert closed[k] == pytest.approx(concentration, rel=1e-9)
        concentration = max(concentration * (1 - nu), 1.0)


@pytest.mark.parametrize(("nu", "expected", "first"), [(0.001, 2300.4, 2301), (0.01, 228.1, 229), (0.1, 20.7, 21)])
def test_rise_time(nu: float, expected: float, first: int) -> None:
    """t₉₀ = ln(0.1 c_ss / (c_ss − 1)) / ln(1 − ν); at ν = 0.1: ln(0.9 / 8) / ln 0.9 = −2.1848 / −0.10536 = 20.74."""
    assert forms.rise_time(nu) == pytest.approx(expected, abs=0.05)
    assert forms.rise_episode(nu) == first
    curve = curves.growth(nu, first)
    wanted = 0.9 * forms.steady_state_concentration(nu)
    assert curve[-2] < wanted <= curve[-1]


def test_rise_time_misprint() -> None:
    """With the sum of Eq. 3.12 as printed, to k, t₉₀ would be about an episode shorter: 227.07 at ν = 0.01."""
    k, q = 227.07, 0.99
    printed = q**k * 2 + q * (1 - q**k) / (1 - q)  # Σ_{i=1}^{k} qⁱ = q (1 − qᵏ) / (1 − q)
    assert printed == pytest.approx(0.9 * 99, abs=1e-3)
    assert forms.rise_time(0.01) - 227.07 == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("nu", "expected", "first"), [(0.001, 692.3, 693), (0.01, 68.46, 69), (0.1, 6.04, 7)])
def test_adaptation_time(nu: float, expected: float, first: int) -> None:
    """Eq. 3.11: ln(c_ss / (2 c_ss − 1)) / ln(1 − ν); at ν = 0.1: ln(9/17) / ln 0.9 = −0.63599 / −0.10536 = 6.036."""
    assert forms.adaptation_time(nu) == pytest.approx(expected, abs=0.005)
    assert forms.adaptation_episode(nu) == first
    after = curves.switch(nu, first)
    assert after.new_best[-2] < after.old_best[-2]
    assert after.new_best[-1] >= after.old_best[-1]


@given(st.lists(st.floats(1e-6, 0.47), min_size=2, max_size=2, unique=True))
def test_times_fall_with_decay(decays: list[float]) -> None:
    """The larger ν, the faster; both times are proportional to 1/ν for small ν."""
    low, high = sorted(decays)
    assert forms.adaptation_time(low) >= forms.adaptation_time(high) > 0.0
    assert forms.rise_time(low) >= forms.rise_time(high) > 0.0
    assert forms.adaptation_time(1e-6) == pytest.approx(math.log(2) / 1e-6, rel=1e-4)
    assert forms.rise_time(1e-6) == pytest.approx(math.log(10) / 1e-6, rel=1e-4)


@pytest.mark.parametrize("nu", [0.5, 0.6, 0.99])
def test_nothing_rises_from_one_half_on(nu: float) -> None:
    """At ν ≥ 1/2 all rest at 1: a uniform choice, adapted at once."""
    assert forms.adaptation_time(nu) == forms.rise_time(nu) == 0.0
    assert forms.selection_probability(nu, 4) == 0.25
    assert curves.growth(nu, 9).tolist() == [1.0] * 10


@given(nu=DECAYS, num_learners=st.integers(2, 20))
def test_selection_probability(nu: float, num_learners: int) -> None:
    """Eq. 3.13 is the Dirichlet mean of the steady state; best and others add up to 1."""
    steady = [forms.steady_state_concentration(nu)] + [1.0] * (num_learners - 1)
    probability = forms.selection_probability(nu, num_learners)
    assert probability == pytest.approx(forms.dirichlet_mean(steady)[0], rel=1e-12)
    assert probability + forms.exploration_probability(nu, num_learners) == pytest.approx(1.0, rel=1e-12)


def test_steady_state_performance() -> None:
    """Eq. 3.14 for n = 2 is G* − ν (G* − G): −2.3 − 0.01 · 97.7 = −3.277. For n = 3 at ν = 0.1, c = (9, 1, 1)."""
    assert forms.steady_state_performance(0.01, -2.3, [-100.0]) == pytest.approx(-3.277, abs=1e-12)
    assert forms.steady_state_performance(0.1, 1.0, [0.0, -1.0]) == pytest.approx((9.0 + 0.0 - 1.0) / 11, rel=1e-12)


@pytest.mark.parametrize("nu", [0.0, 1.0, -0.1, math.nan, math.inf])
def test_decay_out_of_range(nu: float) -> None:
    """Steady states and times need ν in (0, 1)."""
    for function in (forms.steady_state_concentration, forms.adaptation_time, forms.rise_time):
        with pytest.raises(ValueError, match=r"nu: found .*, expected a number above 0 and below 1"):
            function(nu)


def test_other_arguments_out_of_range() -> None:
    """Every argument is checked, and the message says what was found."""
    with pytest.raises(ValueError, match="num_learners: found 1, expected 2 or more"):
        forms.selection_probability(0.1, 1)
    with pytest.raises(ValueError, match=r"fraction: found 1.0"):
        forms.rise_time(0.1, 1.0)
    with pytest.raises(ValueError, match=r"initial: found 0.5"):
        forms.decayed_concentration(0.1, 3, 0.5)
    with pytest.raises(ValueError, match="episodes: found -1"):
        forms.incremented_concentration(0.1, -1)
    with pytest.raises(ValueError, match=r"best_return: found 0.0, expected above the others' highest, 0.0"):
        forms.steady_state_performance(0.1, 0.0, [0.0])
    with pytest.raises(ValueError, match="concentration: found"):
        forms.dirichlet_mean([1.0, 0.0])


def test_curves() -> None:
    """Row 0 is the start: a uniform choice in Fig. 3.2b, c_ss against 1 in Fig. 3.3, whose end mirrors it."""
    moments = curves.growth_moments(0.01, 500, num_learners=2)
    np.testing.assert_allclose([moments.mean[0, 0], moments.variance[0, 0]], [0.5, 0.25 / 3])
    assert np.all(np.diff(moments.mean[:, 0]) > 0)
    assert np.all(np.diff(moments.variance[:, 1]) < 0)
    start, end = (curves.switch_moments(0.05, 2000, num_learners=3).mean[k] for k in (0, -1))
    np.testing.assert_allclose(start, [19 / 21, 1 / 21, 1 / 21])
    np.testing.assert_allclose(end, start[[1, 0, 2]])
    normalised = curves.normalised_switch(0.05, 2000)
    np.testing.assert_allclose([normalised.old_best[0], normalised.new_best[-1]], [1.0, 1.0])
