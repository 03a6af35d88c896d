"""Beyond the text: only the learner that was *selected* can gain, so that P(increment of the best) = P(best selected).

A fresh p ~ Dirichlet(c) is drawn for every episode and used once, so that P(L = i) = cᵢ / Σc exactly: no Dirichlet is
needed here. Returns are deterministic and one learner is strictly best, as in §3.5. The *mean field* replaces each
increment by its probability, c ← max((c + P(L = best)) (1 − ν), 1); the floor and the spread of c around its mean are
what it neglects, a few percent unless ν is close to 1/(n + 1) (`apel.theory.adaptation` simulates the chain itself).

**Range.** The best keeps a lead only while one increment outlives the time to the next: n ≤ 1/ν − 1, so
ν ≤ 1/(n + 1). Beyond it the mean field rests at the floor and says "uniform choice" (c* = 1, P(best) = 1/n). Up to
ν = 1/2 that is a lower bound on P(best): after a lucky selection the best stays above 1 for a few episodes. From
1/2 on it is exact.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from apel.theory.closed_forms import mean_return
from apel.theory.ranges import require_decay, require_fraction, require_learners, require_returns

Floats = NDArray[np.float64]

#: Relative distance of a concentration from its limit at which the rest is summed in closed form.
_CONVERGED = 1e-6


def steady_state_concentration(nu: float, num_learners: int) -> float:
    """c* = max(1/ν − n, 1), the fixed point of c = (c + c / (c + n − 1)) (1 − ν).

    Eq. 3.9 has 1/ν − 1, for any n. The mean over a long run of two learners is 97.6, 17.7 and 8.3 at ν = 0.01, 0.05
    and 0.1, where c* is 98, 18 and 8.

    Raises
    ------
    ValueError
        If ν is outside (0, 1), or there are fewer than 2 learners.

    >>> steady_state_concentration(0.01, 2)
    98.0
    """
    require_decay(nu)
    require_learners(num_learners)
    return max(1.0 / nu - num_learners, 1.0)


def selection_probability(nu: float, num_learners: int) -> float:
    """P(best) = (1 − n ν) / (1 − ν) at the steady state, and 1/n where ν > 1/(n + 1).

    Raises
    ------
    ValueError
        If ν is outside (0, 1), or there are fewer than 2 learners.

    >>> round(selection_probability(0.05, 2), 6)
    0.947368
    """
    concentration = steady_state_concentration(nu, num_learners)
    return concentration / (concentration + num_learners - 1)


def exploration_probability(nu: float, num_learners: int) -> float:
    """P(any but the best) = (n − 1) ν / (1 − ν) at the steady state, and (n − 1)/n where ν > 1/(n + 1).

    Raises
    ------
    ValueError
        If ν is outside (0, 1), or there are fewer than 2 learners.

    >>> round(exploration_probability(0.05, 2), 6)
    0.052632
    """
    return (num_learners - 1) / (steady_state_concentration(nu, num_learners) + num_learners - 1)


def steady_state_performance(nu: float, best_return: float, other_returns: Sequence[float]) -> float:
    """Mean return at the steady state, P(best) G* + (1 − P(best)) · mean of the others' returns.

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
    -3.287
    """
    require_returns(best_return, other_returns)
    return mean_return(exploration_probability(nu, len(other_returns) + 1), best_return, other_returns)


def expected_concentrations(nu: float, initial: Sequence[float], num_episodes: int, best: int = 0) -> Floats:
    """Mean-field concentrations from any start, once every learner was selected and the best is known to be best.

    Parameters
    ----------
    nu:
        ν, 0 ≤ ν < 1.
    initial:
        Concentration of each learner before the first episode, each at least 1.
    num_episodes:
        K ≥ 0.
    best:
        Position of the learner that gains when selected.

    Returns
    -------
    ``float64[K + 1, learners]``; row k holds the concentrations after k episodes.

    Raises
    ------
    ValueError
        If an argument is out of range.

    >>> expected_concentrations(0.1, [1.0, 1.0], 2).round(4).tolist()
    [[1.0, 1.0], [1.35, 1.0], [1.732, 1.0]]
    """
    if nu != 0.0:
        require_decay(nu)
    require_learners(len(initial))
    if min(initial) < 1.0 or num_episodes < 0 or not 0 <= best < len(initial):
        found = f"initial {list(initial)}, num_episodes {num_episodes}, best {best}"
        message = f"found {found}, expected concentrations of at least 1, 0 or more episodes, a position among them"
        raise ValueError(message)
    rows = np.empty((num_episodes + 1, len(initial)))
    rows[0] = initial
    for k in range(num_episodes):
        gained = rows[k].copy()
        gained[best] += gained[best] / gained.sum()
        rows[k + 1] = np.maximum(gained * (1.0 - nu), 1.0)
    return rows


def rise_time(nu: float, num_learners: int, fraction: float = 0.9) -> float:
    """Episodes from all concentrations at 1 until the best one's mean field is a fraction f of c*, as a real number.

    0 where f · c* ≤ 1. Between two episodes the mean field is taken as linear.

    Parameters
    ----------
    nu:
        ν in (0, 1).
    num_learners:
        n ≥ 2.
    fraction:
        f in (0, 1).

    Raises
    ------
    ValueError
        If an argument is out of range.

    >>> round(rise_time(0.01, 2), 1)
    235.4
    """
    require_fraction(fraction)
    wanted = fraction * steady_state_concentration(nu, num_learners)
    before = concentration = 1.0
    episodes = 0
    while concentration < wanted:
        before = concentration
        concentration = (before + before / (before + num_learners - 1)) * (1.0 - nu)
        episodes += 1
    return episodes - (concentration - wanted) / (concentration - before) if episodes else 0.0


def discovery_time(nu: float, num_learners: int) -> float:
    """Mean number of episodes after a switch until the new best learner is selected for the first time.

    Until then nobody can know it, and the old best goes on gaining. It is selected with probability 1 / Σc. For two
    learners the mean is exact: while only the old best is selected, its concentration follows Eq. 3.7 from c*. For
    more, it is taken as its mean field, given that the new best was not selected.

    Raises
    ------
    ValueError
        If ν is outside (0, 1), or there are fewer than 2 learners.

    >>> round(discovery_time(0.01, 2), 1)
    99.5
    """
    return _discovery(nu, num_learners)[0]


def adaptation_time(nu: float, num_learners: int) -> float:
    """Expected episodes after a switch until the new best learner is as likely as the old one, as a real number.

    The wait for the first selection (`discovery_time`), then the mean field from there: the old best only decays,
    the new one gains with probability c₂ / Σc. Starts at the steady state, c* against 1; 0 where c* = 1. To compare
    with Eq. 3.11, which has the new best gain at every episode from the first on. Simulated
    means are 2 % to 6 % larger, and up to 20 % close to ν = 1/(n + 1).

    Raises
    ------
    ValueError
        If ν is outside (0, 1), or there are fewer than 2 learners.

    >>> round(adaptation_time(0.01, 2))
    275
    """
    if steady_state_concentration(nu, num_learners) <= 1.0:
        return 0.0
    waiting, old = _discovery(nu, num_learners)
    new, increment, episodes = 1.0, 1.0, -1.0  # the episode of the discovery is the last one of the wait
    while True:
        gap = old - new
        new = max((new + increment) * (1.0 - nu), 1.0)
        old = max(old * (1.0 - nu), 1.0)
        if new >= old:
            return waiting + episodes + gap / (gap + new - old)
        increment = new / (new + old + num_learners - 2)
        episodes += 1.0


def _discovery(nu: float, num_learners: int) -> tuple[float, float]:
    """Mean wait in episodes, and mean concentration of the old best when it ends."""
    concentration = steady_state_concentration(nu, num_learners)
    # The fixed point given that the new best is not selected: that of n − 1 learners.
    limit = max(1.0 / nu - num_learners + 1.0, 1.0)
    undiscovered, episodes, total = 1.0, 0.0, 0.0
    while limit - concentration > _CONVERGED * limit and undiscovered > _CONVERGED**2:
        hazard = 1.0 / (concentration + num_learners - 1)
        episodes += undiscovered
        total += undiscovered * hazard * concentration
        undiscovered *= 1.0 - hazard
        gain = concentration / (concentration + num_learners - 2)
        concentration = max((concentration + gain) * (1.0 - nu), 1.0)
    remaining = undiscovered * (concentration + num_learners - 1)
    return episodes + remaining, total + undiscovered * concentration
