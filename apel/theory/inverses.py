"""ν from what is wanted of it, by the dissertation's own formulas (§3.6): the inverses of `apel.theory.closed_forms`.

`apel.theory.selection_aware_inverses` answers the same questions by the model that runs follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import scipy

from apel.theory import closed_forms
from apel.theory.ranges import (
    require_exploration,
    require_fraction,
    require_performance,
    require_positive,
    require_selection_probability,
)


def decay_for_adaptation_time(episodes: float) -> float:
    """The ν in (0, 1/2) whose adaptation time is the one wanted (Eq. 3.11, solved numerically: it falls with ν).

    Raises
    ------
    ValueError
        If the time is not a finite number above 0.

    >>> round(decay_for_adaptation_time(100.0), 5)
    0.00687
    """
    require_positive("episodes", episodes)
    return falling_root(closed_forms.adaptation_time, episodes, highest=0.5)


def decay_for_rise_time(episodes: float, fraction: float = 0.9) -> float:
    """The ν whose rise time is the one wanted (Eq. 3.12, solved numerically: it falls with ν).

    Raises
    ------
    ValueError
        If the time is not a finite number above 0, or the fraction is outside (0, 1).

    >>> round(decay_for_rise_time(500.0), 5)
    0.00459
    """
    require_positive("episodes", episodes)
    require_fraction(fraction)
    # f (1/ν − 1) = 1: from here on the start is at the fraction already.
    highest = fraction / (1.0 + fraction)
    return falling_root(lambda nu: closed_forms.rise_time(nu, fraction), episodes, highest)


def decay_for_exploration(exploration: float, num_learners: int) -> float:
    """ν = ε / (1 + (1 − ε)(n − 2)) for the probability ε of any but the best learner (Eq. 3.13).

    Raises
    ------
    ValueError
        If the probability is outside (0, (n − 1)/n].

    >>> decay_for_exploration(0.05, 2)
    0.05
    """
    require_exploration(exploration, num_learners)
    return exploration / (1.0 + (1.0 - exploration) * (num_learners - 2))


def decay_for_selection_probability(probability: float, num_learners: int) -> float:
    """ν = (1 − μ) / (1 + μ (n − 2)) for the probability μ of the best learner (Eq. 3.13).

    Raises
    ------
    ValueError
        If the probability is outside [1/n, 1).

    >>> round(decay_for_selection_probability(0.9, 3), 6)
    0.052632
    """
    require_selection_probability(probability, num_learners)
    return (1.0 - probability) / (1.0 + probability * (num_learners - 2))


def decay_for_performance(performance: float, best_return: float, other_returns: Sequence[float]) -> float:
    """ν = (G* − E[G]) / (G* + E[G] (n − 2) − Σ Gᵢ) for a wanted mean return E[G] at the steady state (Eq. 3.15).

    Raises
    ------
    ValueError
        If the wanted return is below the mean of all returns or not below the best, or the returns are out of range.

    >>> round(decay_for_performance(-3.277, -2.3, [-100.0]), 6)
    0.01
    """
    require_performance(performance, best_return, other_returns)
    # Eq. 3.15 with all returns counted from the best down: no large numbers cancel.
    num_others = len(other_returns)
    loss = best_return - performance
    gaps = sum(best_return - other for other in other_returns)
    return loss / (gaps - (num_others - 1) * loss)


def falling_root(function: Callable[[float], float], value: float, highest: float) -> float:
    """The x in (0, highest) where a function that falls from ∞ to 0 takes a value above 0.

    Sought in ln x, so that the precision is relative.
    """
    if function(highest) >= value:  # by rounding only
        return highest
    lowest = highest / 2.0
    while function(lowest) <= value:
        lowest /= 8.0
    root = scipy.optimize.brentq(
        lambda log: function(math.exp(log)) - value, math.log(lowest), math.log(highest), xtol=1e-13
    )
    return math.exp(root)
