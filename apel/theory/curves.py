"""The curves of Figures 3.2 to 3.4 as plain arrays: who draws them only draws.

All are the dissertation's closed forms; `selection_aware_growth` and `selection_aware_switch` are what to lay beside
them. Row k of a curve holds the values after k episodes, k = 0, …, K.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.theory import closed_forms, selection_aware

Floats = NDArray[np.float64]


class Moments(NamedTuple):
    """Mean and variance of the drawn probabilities, ``float64[K + 1, learners]`` each."""

    mean: Floats
    variance: Floats


class Switch(NamedTuple):
    """Concentrations after a switch, ``float64[K + 1]`` each."""

    old_best: Floats
    new_best: Floats


def growth(nu: float, num_episodes: int, initial: float = 1.0) -> Floats:
    """Figure 3.2a: ``float64[K + 1]``, the concentration of a learner that gains at every episode; 0 ≤ ν < 1.

    >>> growth(0.0, 3).tolist()
    [1.0, 2.0, 3.0, 4.0]
    """
    return closed_forms.incremented_concentration(nu, np.arange(num_episodes + 1), initial)


def growth_moments(nu: float, num_episodes: int, num_learners: int = 2) -> Moments:
    """Figure 3.2b: probabilities while learner 0 gains at every episode and all others rest at 1; 0 ≤ ν < 1.

    >>> growth_moments(0.01, 1000).mean[-1].round(3).tolist()
    [0.99, 0.01]
    """
    concentration = np.ones((num_episodes + 1, num_learners))
    concentration[:, 0] = growth(nu, num_episodes)
    return _moments(concentration)


def switch(nu: float, num_episodes: int) -> Switch:
    """Concentrations after the best has changed: the old one decays from c_ss, the new one gains from 1; 0 < ν < 1.

    >>> curves = switch(0.01, 100)
    >>> int(np.argmax(curves.new_best >= curves.old_best))
    69
    """
    steady = closed_forms.steady_state_concentration(nu)
    episodes = np.arange(num_episodes + 1)
    return Switch(closed_forms.decayed_concentration(nu, episodes, steady), growth(nu, num_episodes))


def normalised_switch(nu: float, num_episodes: int) -> Switch:
    """Figure 3.3a: the curves of `switch` divided by c_ss: the old best starts at 1, the new one at 1/c_ss, about ν.

    >>> [float(curve[0]) for curve in normalised_switch(0.2, 5)]
    [1.0, 0.25]
    """
    steady = closed_forms.steady_state_concentration(nu)
    return Switch(*(curve / steady for curve in switch(nu, num_episodes)))


def switch_moments(nu: float, num_episodes: int, num_learners: int = 2) -> Moments:
    """Figure 3.3b: probabilities after a switch; learner 0 is the old best, 1 the new one, all others rest at 1.

    >>> switch_moments(0.01, 69).mean[[0, 69], 1].round(2).tolist()
    [0.01, 0.5]
    """
    concentration = np.ones((num_episodes + 1, num_learners))
    concentration[:, 0], concentration[:, 1] = switch(nu, num_episodes)
    return _moments(concentration)


def adaptation_times(decays: Sequence[float]) -> Floats:
    """Figure 3.4a: ``float64[decays]``, episodes until both learners are equally likely again.

    >>> adaptation_times([0.001, 0.01, 0.1]).round(2).tolist()
    [692.3, 68.46, 6.04]
    """
    return np.array([closed_forms.adaptation_time(nu) for nu in decays])


def rise_times(decays: Sequence[float], fraction: float = 0.9) -> Floats:
    """Figure 3.4b: ``float64[decays]``, episodes until a fraction of the steady state.

    >>> rise_times([0.001, 0.01, 0.1]).round(1).tolist()
    [2300.4, 228.1, 20.7]
    """
    return np.array([closed_forms.rise_time(nu, fraction) for nu in decays])


def selection_aware_growth(nu: float, num_episodes: int, num_learners: int = 2) -> Floats:
    """The counterpart of `growth`, ``float64[K + 1]``: the mean field where only the selected learner can gain.

    >>> selection_aware_growth(0.0, 2).round(3).tolist()
    [1.0, 1.5, 2.1]
    """
    return selection_aware.expected_concentrations(nu, [1.0] * num_learners, num_episodes)[:, 0]


def selection_aware_switch(nu: float, num_episodes: int, num_learners: int = 2) -> Switch:
    """The counterpart of `switch`, *from the first selection of the new best on*: the mean field from c* and 1.

    The wait before it is `selection_aware.discovery_time`; its curve would mean little, since that wait is as long on
    average as its spread.

    >>> curves = selection_aware_switch(0.01, 300)
    >>> int(np.argmax(curves.new_best >= curves.old_best))
    176
    """
    steady = selection_aware.steady_state_concentration(nu, num_learners)
    rest = [1.0] * (num_learners - 2)
    start = [max(steady * (1.0 - nu), 1.0), max(2.0 * (1.0 - nu), 1.0), *rest]
    rows = selection_aware.expected_concentrations(nu, start, num_episodes, best=1)
    return Switch(rows[:, 0], rows[:, 1])


def _moments(concentration: Floats) -> Moments:
    return Moments(closed_forms.dirichlet_mean(concentration), closed_forms.dirichlet_variance(concentration))
