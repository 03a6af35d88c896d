"""APEL's concentrations as a Markov chain, many chains side by side (Algorithm 5), with or without noise and floor.

Written from the text, for arrays, and apart from the selectors, so that each can test the other. The learner is drawn
from cᵢ / Σc, which is the selection's distribution once the Dirichlet draw is averaged out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from apel.theory.ranges import require_decay, require_learners

Floats = NDArray[np.float64]
Learners = NDArray[np.intp]


@dataclass
class Chains:
    """The state of C independent ensembles of n learners.

    Attributes
    ----------
    nu:
        ν, 0 ≤ ν < 1.
    performance:
        ``float64[learners]``: what each learner earns whenever it is selected. May be changed between two steps.
    concentration:
        ``float64[learners, chains]``.
    estimate:
        ``float64[learners, chains]``: each learner's latest performance, NaN until it is selected.
    floor:
        ρ ≥ 0: of every episode each learner has at least this probability, p ← (1 − nρ) p + ρ.
    """

    nu: float
    performance: Floats
    concentration: Floats
    estimate: Floats
    floor: float = 0.0

    def weights(self) -> Floats:
        """``float64[learners, chains]``, proportional to the probabilities of the next selection."""
        if not self.floor:
            return self.concentration
        raised = self.floor * self.concentration.sum(axis=0)
        return (1.0 - len(self.concentration) * self.floor) * self.concentration + raised

    def step(self, uniform: Floats, noise: Floats | float = 0.0) -> Learners:
        """Play one episode: select, observe, increment, decay. Returns the learner that each chain selected.

        Parameters
        ----------
        uniform:
            ``float64[chains]``, drawn from [0, 1).
        noise:
            ``float64[chains]``, added to what the selected learners earn.
        """
        selected = _categorical(self.weights(), uniform)
        chain = np.arange(len(selected))
        earned = self.performance[selected] + noise
        self.estimate[selected, chain] = earned
        # Comparing with NaN gives False: whoever was never selected cannot be beaten, and nothing is incremented.
        unbeaten = np.count_nonzero(~(self.estimate < earned), axis=0)
        self.concentration[selected, chain] += unbeaten == 1  # by itself alone
        self.concentration *= 1.0 - self.nu
        np.maximum(self.concentration, 1.0, out=self.concentration)
        return selected


def make_chains(
    nu: float,
    performance: ArrayLike,
    num_chains: int,
    concentration: Sequence[float] | None = None,
    estimate: Sequence[float] | None = None,
) -> Chains:
    """Chains that all start alike.

    Parameters
    ----------
    nu:
        ν, 0 ≤ ν < 1.
    performance:
        ``float64[learners]``.
    num_chains:
        C ≥ 1.
    concentration:
        One per learner, each at least 1; all 1 by default.
    estimate:
        Latest performance of each learner; by default none was selected yet.

    Raises
    ------
    ValueError
        If an argument is out of range, or not one per learner.

    >>> chains = make_chains(0.1, [1.0, 0.0], 3, estimate=[1.0, 0.0])
    >>> chains.step(np.array([0.0, 0.4, 0.6])).tolist()
    [0, 0, 1]
    >>> chains.concentration.tolist()
    [[1.8, 1.8, 1.0], [1.0, 1.0, 1.0]]
    """
    if nu != 0.0:
        require_decay(nu)
    performance = np.asarray(performance, dtype=np.float64)
    num_learners = len(performance)
    require_learners(num_learners)
    start = np.ones(num_learners) if concentration is None else np.asarray(concentration, dtype=np.float64)
    latest = np.full(num_learners, np.nan) if estimate is None else np.asarray(estimate, dtype=np.float64)
    for name, array in (("concentration", start), ("estimate", latest)):
        if array.shape != performance.shape:
            message = f"{name}: found {array.shape[0]} values, expected one per learner, {num_learners}"
            raise ValueError(message)
    if not np.all(start >= 1.0) or num_chains < 1:
        message = f"found concentrations {start.tolist()}, {num_chains} chains, expected each to be at least 1"
        raise ValueError(message)
    return Chains(nu, performance, np.tile(start[:, None], (1, num_chains)), np.tile(latest[:, None], (1, num_chains)))


def _categorical(weights: Floats, uniform: Floats) -> Learners:
    """The learner in whose part of [0, Σ weights) the draw falls, for every chain."""
    point = uniform * weights.sum(axis=0)
    selected = np.zeros(len(point), dtype=np.intp)
    edge = np.zeros(len(point))
    for weight in weights[:-1]:
        edge += weight
        selected += point >= edge
    return selected
