"""The selection-aware model with noise in the performances, and with a floor under acting: simulated chains.

Performances are normal, all with the same spread; in one draw of each the best learner beats another one with
probability p. Of the floor ρ episodes are taken to be equally long. No mean field does for this: a learner that was
lucky keeps its estimate until it is selected again, about as long as a concentration takes to decay, so that the two
cannot be averaged apart. With p = 1 and ρ = 0 it is the model of `apel.theory.selection_aware`.

A mean over simulated chains errs by about 1 %; equal seeds give equal draws at every ν.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import scipy

from apel.theory.chains import Chains, Floats, make_chains
from apel.theory.ranges import require_decay, require_fraction, require_learners
from apel.theory.selection_aware import steady_state_concentration

LEAST_DECAY = 5e-4
"""Below, a simulation takes tens of seconds."""
_NUM_CHAINS = 1000
# In units of 1/ν, the time in which a concentration is forgotten.
_SETTLING, _MEASURED, _LONGEST = 12.0, 8.0, 40.0
_STEP = 4.0


@dataclass(frozen=True)
class Noisy:
    """An ensemble in which one learner is the best, though not in every episode.

    Attributes
    ----------
    num_learners:
        n ≥ 2.
    win_probability:
        p, above 1/2: with which one performance of the best is above one of another learner.
    floor:
        ρ, 0 ≤ ρ < 1/n: the least probability of every learner.

    Raises
    ------
    ValueError
        If one is out of range.
    """

    num_learners: int = 2
    win_probability: float = 1.0
    floor: float = 0.0

    def __post_init__(self) -> None:
        require_learners(self.num_learners)
        if not 0.5 < self.win_probability <= 1.0:
            message = f"win_probability: found {self.win_probability}, expected above 0.5 and at most 1"
            raise ValueError(message)
        if not 0.0 <= self.floor < 1.0 / self.num_learners:
            message = f"floor: found {self.floor}, expected at least 0 and below 1/n = {1.0 / self.num_learners:.6g}"
            raise ValueError(message)

    @property
    def lead(self) -> float:
        """Of the best learner's mean, in standard deviations: √2 Φ⁻¹(p); 1 without any noise."""
        return 1.0 if self.win_probability == 1.0 else math.sqrt(2.0) * NormalDist().inv_cdf(self.win_probability)


class Settled(NamedTuple):
    """Means at the steady state."""

    concentration: float
    """Of the best learner."""
    selection_probability: float
    """Of the best learner."""

    @property
    def exploration_probability(self) -> float:
        """Of any but the best."""
        return 1.0 - self.selection_probability


class _Draws:
    """What chance adds to every episode of all chains."""

    def __init__(self, ensemble: Noisy, seed: int) -> None:
        self._is_noisy = ensemble.win_probability < 1.0
        self._uniform, self._normal = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(2))

    def play(self, chains: Chains) -> None:
        """One episode."""
        noise = self._normal.standard_normal(_NUM_CHAINS) if self._is_noisy else 0.0
        chains.step(self._uniform.random(_NUM_CHAINS), noise)

    def estimates(self, num_learners: int) -> Floats:
        """``float64[learners, chains]``, about the means."""
        return self._normal.standard_normal((num_learners, _NUM_CHAINS)) if self._is_noisy else np.zeros((1, 1))


def steady_state(nu: float, ensemble: Noisy, seed: int = 0) -> Settled:
    """What an ensemble settles to.

    Raises
    ------
    ValueError
        If ν is outside (0, 1).

    >>> found = steady_state(0.05, Noisy(num_learners=4, win_probability=0.7))
    >>> round(found.exploration_probability, 1)
    0.4
    """
    chains, draws = _settled(nu, ensemble, seed)
    concentration = probability = 0.0
    episodes = math.ceil(_MEASURED / nu)
    for _ in range(episodes):
        weights = chains.weights()
        probability += float((weights[0] / weights.sum(axis=0)).mean())
        concentration += float(chains.concentration[0].mean())
        draws.play(chains)
    return Settled(concentration / episodes, probability / episodes)


def adaptation_time(nu: float, ensemble: Noisy, seed: int = 0) -> float:
    """Mean number of episodes after a switch until the new best learner's concentration is at least the old one's.

    The new best beats the old one with probability p, and the others more often. ∞ where some chain needs more than
    40/ν episodes.

    Raises
    ------
    ValueError
        If ν is outside (0, 1).
    """
    chains, draws = _settled(nu, ensemble, seed)
    chains.performance[1] = 2.0 * ensemble.lead
    times = np.where(chains.concentration[1] >= chains.concentration[0], 0.0, np.inf)
    for episode in range(1, math.ceil(_LONGEST / nu) + 1):
        waiting = np.isinf(times)
        if not waiting.any():
            break
        draws.play(chains)
        times[waiting & (chains.concentration[1] >= chains.concentration[0])] = episode
    return float(times.mean())


def rise_time(nu: float, ensemble: Noisy, fraction: float = 0.9, seed: int = 0) -> float:
    """Episodes from all concentrations at 1 until the best one's mean is a fraction of that at the steady state.

    Raises
    ------
    ValueError
        If ν or the fraction is outside (0, 1).
    """
    require_fraction(fraction)
    wanted = fraction * steady_state(nu, ensemble, seed).concentration
    chains, draws = _begun(nu, ensemble), _Draws(ensemble, seed + 1)
    before, episodes = 1.0, 0
    while episodes < _LONGEST / nu:
        mean = float(chains.concentration[0].mean())
        if mean >= wanted:
            return max(0.0, episodes - (mean - wanted) / (mean - before)) if episodes else 0.0
        before = mean
        draws.play(chains)
        episodes += 1
    return math.inf


def decay_for(measure: Callable[[float], float], wanted: float, num_learners: int, *, rising: bool) -> float:
    """The ν from `LEAST_DECAY` to 1/(n + 1) at which a measure is what is wanted, to about 0.1 %.

    Parameters
    ----------
    measure:
        Of ν; has to rise, or to fall, with it.
    wanted:
        Its value, finite.
    num_learners:
        n.
    rising:
        Whether it rises.

    Raises
    ------
    ValueError
        If no such ν gives it.
    """
    lowest, highest = LEAST_DECAY, 1.0 / (num_learners + 1)
    found_at, sign = cache(measure), 1.0 if rising else -1.0

    def excess(nu: float) -> float:
        return max(sign * (found_at(nu) - wanted), -1e9)  # times may be infinite

    # From above, since simulations take the longer the smaller ν is.
    below = above = highest
    while excess(below) > 0.0 and below > lowest:
        below, above = max(below / _STEP, lowest), below
    if excess(below) * excess(above) > 0.0:
        least, most = sorted(map(found_at, (lowest, highest)))
        message = f"found {wanted:g}, expected {least:.4g} to {most:.4g}, from ν = {lowest:g} to {highest:.4g}"
        raise ValueError(message)
    return float(scipy.optimize.brentq(excess, below, above, rtol=1e-3))


def _begun(nu: float, ensemble: Noisy) -> Chains:
    require_decay(nu)
    performance = [ensemble.lead] + [0.0] * (ensemble.num_learners - 1)
    chains = make_chains(nu, performance, _NUM_CHAINS)
    chains.floor = ensemble.floor
    return chains


def _settled(nu: float, ensemble: Noisy, seed: int) -> tuple[Chains, _Draws]:
    """Chains after long enough to have forgotten how they began, with the mean field of p = 1 as a first guess."""
    chains, draws = _begun(nu, ensemble), _Draws(ensemble, seed)
    chains.concentration[0] = steady_state_concentration(nu, ensemble.num_learners)
    chains.estimate[:] = chains.performance[:, None] + draws.estimates(ensemble.num_learners)
    for _ in range(math.ceil(_SETTLING / nu)):
        draws.play(chains)
    return chains, draws
