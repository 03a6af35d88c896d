"""The closed forms of §3.5 and §3.6: the best learner's concentration is incremented at *every* episode.

That is the dissertation's assumption, and an upper bound: in play only the learner that was selected can gain (see
`apel.theory.selection_aware`). Times are in episodes; concentrations are those at the start of an episode, after the
increment and the decay of the one before. ν is the decay. From ν = 1/2 on, one increment is gone within one episode,
the floor of Eq. 3.5 holds every concentration at 1, and the steady state is a uniform choice.

Source: Crafford (2021), Equations 3.1 to 3.14; where the text drops the floor max(…, 1) it is put back.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from apel.theory.ranges import require_decay, require_fraction, require_learners, require_returns

Floats = NDArray[np.float64]

#: A time that is a whole number but for rounding counts as that number.
_ROUNDING = 1e-9


def dirichlet_mean(concentration: ArrayLike) -> Floats:
    """E[pᵢ] = cᵢ / Σc, which is also the probability that learner i is selected (Eq. 3.1).

    Parameters
    ----------
    concentration:
        ``float64[..., learners]``, each above 0.

    Raises
    ------
    ValueError
        If a concentration is not above 0.

    >>> dirichlet_mean([3.0, 1.0]).tolist()
    [0.75, 0.25]
    """
    c = _positive(concentration)
    return c / c.sum(axis=-1, keepdims=True)


def dirichlet_variance(concentration: ArrayLike) -> Floats:
    """Var[pᵢ] = E[pᵢ] (1 − E[pᵢ]) / (Σc + 1) (Eq. 3.1).

    Parameters
    ----------
    concentration:
        ``float64[..., learners]``, each above 0.

    Raises
    ------
    ValueError
        If a concentration is not above 0.

    >>> dirichlet_variance([3.0, 1.0]).tolist()
    [0.0375, 0.0375]
    """
    c = _positive(concentration)
    mean = dirichlet_mean(c)
    return mean * (1.0 - mean) / (c.sum(axis=-1, keepdims=True) + 1.0)


def steady_state_concentration(nu: float) -> float:
    """c_ss = max(1/ν − 1, 1): where (c + 1)(1 − ν) = c (Eq. 3.9, with the floor of Eq. 3.5).

    Raises
    ------
    ValueError
        If ν is outside (0, 1).

    >>> steady_state_concentration(0.01)
    99.0
    """
    require_decay(nu)
    return max(1.0 / nu - 1.0, 1.0)


def incremented_concentration(nu: float, episodes: ArrayLike, initial: float = 1.0) -> Floats:
    """Concentration of a learner that gains at every episode: c_k = c_ss + (1 − ν)ᵏ (c₀ − c_ss), c_ss = 1/ν − 1.

    Equal to Eq. 3.7, (1 − ν)ᵏ (c₀ + 1) + Σ_{i=1}^{k−1} (1 − ν)ⁱ. Without decay it is c₀ + k.

    Parameters
    ----------
    nu:
        ν, 0 ≤ ν < 1.
    episodes:
        k ≥ 0, of any shape.
    initial:
        c₀ ≥ 1.

    Raises
    ------
    ValueError
        If an argument is out of range.

    >>> incremented_concentration(0.1, [0, 1, 2]).round(6).tolist()
    [1.0, 1.8, 2.52]
    """
    k = _start(nu, episodes, initial)
    if nu == 0.0:
        return initial + k
    steady = 1.0 / nu - 1.0
    return np.maximum(steady + np.exp(k * math.log1p(-nu)) * (initial - steady), 1.0)


def decayed_concentration(nu: float, episodes: ArrayLike, initial: float) -> Floats:
    """Concentration of a learner that gains no more: c_k = max(c₀ (1 − ν)ᵏ, 1) (Eq. 3.10, second line).

    Its first line would let the concentration dip below 1 for one episode; Eq. 3.5 does not.

    Parameters
    ----------
    nu:
        ν, 0 ≤ ν < 1.
    episodes:
        k ≥ 0, of any shape.
    initial:
        c₀ ≥ 1.

    Raises
    ------
    ValueError
        If an argument is out of range.

    >>> decayed_concentration(0.5, [0, 1, 2, 3], 4.0).tolist()
    [4.0, 2.0, 1.0, 1.0]
    """
    k = _start(nu, episodes, initial)
    return np.maximum(initial * np.exp(k * math.log1p(-nu)), 1.0)


def adaptation_time(nu: float) -> float:
    """Episodes after a switch until both learners are equally likely again (Eq. 3.11), as a real number.

    c_ss (1 − ν)ᵏ = c_ss + (1 − ν)ᵏ (1 − c_ss) gives k = ln(c_ss / (2 c_ss − 1)) / ln(1 − ν), about ln 2 / ν. The
    old learner starts at c_ss, the new one at 1; the floor is not met on the way. 0 from ν = 1/2 on, where c_ss = 1.

    Raises
    ------
    ValueError
        If ν is outside (0, 1).

    >>> round(adaptation_time(0.01), 2)
    68.46
    """
    steady = steady_state_concentration(nu)
    return math.log(steady / (2.0 * steady - 1.0)) / math.log1p(-nu) + 0.0  # no negative zero


def adaptation_episode(nu: float) -> int:
    """The first whole number of episodes that is at least `adaptation_time`.

    Raises
    ------
    ValueError
        If ν is outside (0, 1).

    >>> adaptation_episode(0.01)
    69
    """
    return math.ceil(adaptation_time(nu) - _ROUNDING)


def rise_time(nu: float, fraction: float = 0.9) -> float:
    """Episodes from c₀ = 1 until the concentration is a fraction f of its steady state, as a real number; t₉₀.

    k = ln((1 − f) c_ss / (c_ss − 1)) / ln(1 − ν); 0 where f · c_ss ≤ 1 (Eq. 3.12). As printed, the sum of Eq. 3.12
    ends at k, where that of Eq. 3.7 ends at k − 1: a misprint, which would make every rise time about one episode
    shorter.

    Parameters
    ----------
    nu:
        ν in (0, 1).
    fraction:
        f in (0, 1).

    Raises
    ------
    ValueError
        If an argument is out of range.

    >>> round(rise_time(0.01), 1)
    228.1
    """
    require_fraction(fraction)
    steady = steady_state_concentration(nu)
    if fraction * steady <= 1.0:
        return 0.0
    return math.log((1.0 - fraction) * steady / (steady - 1.0)) / math.log1p(-nu)


def rise_episode(nu: float, fraction: float = 0.9) -> int:
    """The first whole number of episodes that is at least `rise_time`.

    Raises
    ------
    ValueError
        If an argument is out of range.

    >>> rise_episode(0.01)
    229
    """
    return math.ceil(rise_time(nu, fraction) - _ROUNDING)


def selection_probability(nu: float, num_learners: int) -> float:
    """Probability of the best of n learners at the steady state, μ = c_ss / (c_ss + n − 1) (Eq. 3.13).

    Raises
    ------
    ValueError
        If ν is outside (0, 1), or there are fewer than 2 learners.

    >>> selection_probability(0.01, 2)
    0.99
    """
    require_learners(num_learners)
    steady = steady_state_concentration(nu)
    return steady / (steady + num_learners - 1)


def exploration_probability(nu: float, num_learners: int) -> float:
    """Probability of any other than the best at the steady state, 1 − μ = (n − 1) / (c_ss + n − 1) (Eq. 3.13).

    Raises
    ------
    ValueError
        If ν is outside (0, 1), or there are fewer than 2 learners.

    >>> exploration_probability(0.01, 2)
    0.01
    """
    require_learners(num_learners)
    return (num_learners - 1) / (steady_state_concentration(nu) + num_learners - 1)


def steady_state_performance(nu: float, best_return: float, other_returns: Sequence[float]) -> float:
    """Mean return at the steady state, μ G* + (1 − μ) · mean of the others' returns (Eq. 3.14).

    Parameters
    ----------
    nu:
        ν in (0, 1).
    best_return:
        G*, above all others.
    other_returns:
        G₂, …, G_n: one per other learner.

    Raises
    ------
    ValueError
        If an argument is out of range.

    >>> round(steady_state_performance(0.01, -2.3, [-100.0]), 3)
    -3.277
    """
    require_returns(best_return, other_returns)
    return mean_return(exploration_probability(nu, len(other_returns) + 1), best_return, other_returns)


def mean_return(exploration: float, best_return: float, other_returns: Sequence[float]) -> float:
    """(1 − ε) G* + ε · mean of the others' returns, for the probability ε of any other than the best (Eq. 3.14).

    >>> mean_return(0.5, 1.0, [0.0, -2.0])
    0.0
    """
    return (1.0 - exploration) * best_return + exploration * sum(other_returns) / len(other_returns)


def _positive(concentration: ArrayLike) -> Floats:
    c = np.asarray(concentration, dtype=np.float64)
    if c.ndim == 0 or not np.all(c > 0.0):
        message = f"concentration: found {concentration!r}, expected an array of numbers above 0, one per learner"
        raise ValueError(message)
    return c


def _start(nu: float, episodes: ArrayLike, initial: float) -> Floats:
    if nu != 0.0:
        require_decay(nu)
    if not 1.0 <= initial < math.inf:
        message = f"initial: found {initial}, expected a finite concentration of at least 1"
        raise ValueError(message)
    k = np.asarray(episodes, dtype=np.float64)
    if not np.all(k >= 0.0):
        message = f"episodes: found {episodes!r}, expected numbers of at least 0"
        raise ValueError(message)
    return k
