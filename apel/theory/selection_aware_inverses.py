"""ν from what is wanted of it, by the model that runs follow: the inverses of `apel.theory.selection_aware`.

Every ν is in (0, 1/(n + 1)]: beyond, no learner keeps a lead. Times have no closed form and, for many learners close to
1/(n + 1), are no longer monotone in ν; the smallest ν that meets a time is the answer, as it explores least.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import scipy

from apel.theory import selection_aware
from apel.theory.ranges import (
    require_exploration,
    require_fraction,
    require_learners,
    require_performance,
    require_positive,
    require_selection_probability,
)

#: Step of the search for a bracket; small enough for the first of two solutions not to be jumped over.
_STEP = 1.1


def decay_for_adaptation_time(episodes: float, num_learners: int) -> float:
    """The smallest ν whose expected adaptation time is the one wanted.

    Raises
    ------
    ValueError
        If the time is shorter than any ν up to 1/(n + 1) allows: the new best must first be selected by chance.

    >>> round(decay_for_adaptation_time(275.27, 2), 4)
    0.01
    """
    require_positive("episodes", episodes)
    require_learners(num_learners)
    # The time exceeds the wait for the first selection less 1, which exceeds 1/ν − 2.
    lowest = min(1.0 / (episodes + 2.0), 0.5 / (num_learners + 1))
    highest = (1.0 - 1e-9) / (num_learners + 1)
    return _first_root(lambda nu: selection_aware.adaptation_time(nu, num_learners), episodes, lowest, highest)


def decay_for_rise_time(episodes: float, num_learners: int, fraction: float = 0.9) -> float:
    """The smallest ν whose rise time is the one wanted.

    Raises
    ------
    ValueError
        If the time is not a finite number above 0, there are fewer than 2 learners, or the fraction is outside (0, 1).

    >>> round(decay_for_rise_time(235.35, 2), 4)
    0.01
    """
    require_positive("episodes", episodes)
    require_learners(num_learners)
    require_fraction(fraction)
    # At most 1 is gained per episode, so that the time is at least f (1/ν − n) − 1; f · c* = 1 at the other end.
    lowest = fraction / (episodes + 2.0 + fraction * num_learners)
    highest = fraction / (1.0 + fraction * num_learners)
    return _first_root(lambda nu: selection_aware.rise_time(nu, num_learners, fraction), episodes, lowest, highest)


def decay_for_exploration(exploration: float, num_learners: int) -> float:
    """ν = ε / (n − 1 + ε) for the probability ε of any but the best learner.

    Raises
    ------
    ValueError
        If the probability is outside (0, (n − 1)/n].

    >>> round(decay_for_exploration(0.05, 2), 6)
    0.047619
    """
    require_exploration(exploration, num_learners)
    return exploration / (num_learners - 1 + exploration)


def decay_for_selection_probability(probability: float, num_learners: int) -> float:
    """ν = (1 − P) / (n − P) for the probability P of the best learner.

    Raises
    ------
    ValueError
        If the probability is outside [1/n, 1).

    >>> round(decay_for_selection_probability(0.9, 3), 6)
    0.047619
    """
    require_selection_probability(probability, num_learners)
    return (1.0 - probability) / (num_learners - probability)


def decay_for_performance(performance: float, best_return: float, other_returns: Sequence[float]) -> float:
    """ν = (G* − E[G]) / (G* − E[G] + Σ (G* − Gᵢ)) for a wanted mean return E[G] at the steady state.

    The counterpart of Eq. 3.15: ε = (n − 1)(G* − E[G]) / Σ (G* − Gᵢ) put into `decay_for_exploration`.

    Raises
    ------
    ValueError
        If the wanted return is below the mean of all returns or not below the best, or the returns are out of range.

    >>> round(decay_for_performance(-3.287, -2.3, [-100.0]), 4)
    0.01
    """
    require_performance(performance, best_return, other_returns)
    loss = best_return - performance
    return loss / (loss + sum(best_return - other for other in other_returns))


def _first_root(function: Callable[[float], float], value: float, lowest: float, highest: float) -> float:
    """The smallest x where a function takes a value that it exceeds at ``lowest``; sought in ln x."""
    below = lowest
    while below < highest:
        above = min(below * _STEP, highest)
        if function(above) <= value:
            log = scipy.optimize.brentq(
                lambda x: function(math.exp(x)) - value, math.log(below), math.log(above), xtol=1e-12
            )
            return math.exp(log)
        below = above
    message = f"episodes: found {value:g}, expected at least {function(highest):.3g}: no decay is faster"
    raise ValueError(message)
