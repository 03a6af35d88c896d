"""The distribution of the adaptation time: simulated chains, from a switch on.

Up to the switch learner 0 was the best, and the ensemble has settled; from then on learner 1 is strictly better. Nobody
knows: learner 0 goes on gaining until learner 1 is selected for the first time, and gains no more from then on. All
others stay below both. Two readings of "adapted":

- the **crossing**, as in Eq. 3.11: the first episode after which c₁ ≥ c₀;
- the **measured** one, as in Figures 4.11 to 4.13 (`WindowCriterion`): the first episode at which the mean length of
  the last few episodes, all of them after the switch, is below a threshold. It comes later: these have to be good ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from apel.theory.chains import Chains, Floats, Learners, make_chains
from apel.theory.ranges import require_decay, require_learners
from apel.theory.selection_aware import steady_state_concentration


@dataclass(frozen=True)
class WindowCriterion:
    """The mean length of the last ``window`` episodes is below ``threshold``.

    Attributes
    ----------
    lengths:
        Of each learner's episodes after the switch: a constant (its mean length), or an array of observed lengths, from
        which one is drawn for every episode.
    threshold:
        In the unit of the lengths.
    window:
        Episodes; at least 1.
    """

    lengths: Sequence[ArrayLike]
    threshold: float
    window: int = 50


@dataclass(frozen=True)
class AdaptationTimes:
    """Episodes from the switch until adapted, ``float64[chains]``; ∞ where a chain had not adapted at the end."""

    episodes: Floats

    @property
    def mean(self) -> float:
        """Mean over all chains; ∞ if one did not adapt."""
        return float(self.episodes.mean())

    @property
    def standard_deviation(self) -> float:
        """Over the chains that adapted; NaN if there are fewer than two."""
        adapted = self.episodes[np.isfinite(self.episodes)]
        return float(adapted.std(ddof=1)) if len(adapted) > 1 else math.nan

    @property
    def num_censored(self) -> int:
        """Number of chains that had not adapted at the end."""
        return int(np.isinf(self.episodes).sum())

    def quantile(self, probability: Sequence[float]) -> Floats:
        """Quantiles over all chains, each one that occurred; ∞ among those that did not adapt."""
        return np.quantile(self.episodes, probability, method="inverted_cdf")


def adaptation_time_distribution(
    nu: float,
    num_learners: int = 2,
    *,
    criterion: WindowCriterion | None = None,
    switch_episode: int | None = None,
    num_chains: int = 2000,
    max_episodes: int | None = None,
    seed: int = 0,
) -> AdaptationTimes:
    """Simulate the time from a switch until APEL has adapted.

    Parameters
    ----------
    nu:
        ν, 0 ≤ ν < 1. Without decay there is no steady state: ``switch_episode`` and ``max_episodes`` are needed then.
    num_learners:
        n ≥ 2.
    criterion:
        The measured reading; the crossing by default.
    switch_episode:
        Episodes played before the switch, from all concentrations at 1. By default the switch comes at the steady
        state: learner 0 at c* = 1/ν − n, all others at 1.
    num_chains:
        The standard error of the mean is about 1/3 of the mean over √num_chains.
    max_episodes:
        Episodes after which a chain counts as censored; 40/ν and one window by default, which is unlikely to be met.
    seed:
        Of the chains. Equal seeds give equal draws at every ν, so that differences in ν are not noise.

    Raises
    ------
    ValueError
        If an argument is out of range.

    >>> times = adaptation_time_distribution(0.1, num_chains=500)
    >>> bool(18 < times.mean < 23), times.num_censored
    (True, 0)
    """
    require_learners(num_learners)
    if nu != 0.0:
        require_decay(nu)
    elif switch_episode is None or max_episodes is None:
        message = f"nu: found {nu}, expected above 0, or a switch_episode and max_episodes"
        raise ValueError(message)
    window = 0 if criterion is None else criterion.window
    last = math.ceil(40.0 / nu) + window if max_episodes is None else max_episodes
    chain_seed, length_seed = np.random.SeedSequence(seed).spawn(2)
    draws = np.random.default_rng(chain_seed)
    chains = _at_the_switch(nu, num_learners, switch_episode, num_chains, draws)
    chains.performance[1] = 2.0
    if criterion is None:
        return AdaptationTimes(_crossing_times(chains, last, draws))
    lengths = _Lengths(criterion.lengths, num_learners, np.random.default_rng(length_seed))
    return AdaptationTimes(_window_times(chains, last, draws, lengths, criterion))


def _at_the_switch(
    nu: float, num_learners: int, switch_episode: int | None, num_chains: int, draws: np.random.Generator
) -> Chains:
    performance = [1.0] + [0.0] * (num_learners - 1)
    if switch_episode is None:
        settled = [steady_state_concentration(nu, num_learners)] + [1.0] * (num_learners - 1)
        return make_chains(nu, performance, num_chains, settled, performance)
    chains = make_chains(nu, performance, num_chains)
    for _ in range(switch_episode):
        chains.step(draws.random(num_chains))
    return chains


def _crossing_times(chains: Chains, last: int, draws: np.random.Generator) -> Floats:
    times = np.where(chains.concentration[1] >= chains.concentration[0], 0.0, np.inf)
    for episode in range(1, last + 1):
        waiting = np.isinf(times)
        if not waiting.any():
            break
        chains.step(draws.random(len(times)))
        times[waiting & (chains.concentration[1] >= chains.concentration[0])] = episode
    return times


def _window_times(
    chains: Chains, last: int, draws: np.random.Generator, lengths: _Lengths, criterion: WindowCriterion
) -> Floats:
    num_chains: int = chains.concentration.shape[1]
    times = np.full(num_chains, np.inf)
    if criterion.window < 1:
        message = f"window: found {criterion.window}, expected 1 or more"
        raise ValueError(message)
    recent = np.zeros((criterion.window, num_chains))
    for episode in range(1, last + 1):
        recent[episode % criterion.window] = lengths.draw(chains.step(draws.random(num_chains)))
        if episode >= criterion.window:
            # Summed afresh, as the runs' criterion is: no rounding error builds up.
            times[np.isinf(times) & (recent.sum(axis=0) / criterion.window < criterion.threshold)] = episode
            if not np.isinf(times).any():
                break
    return times


class _Lengths:
    """Episode lengths of the selected learners, constant or drawn with replacement from those observed."""

    def __init__(self, lengths: Sequence[ArrayLike], num_learners: int, draws: np.random.Generator) -> None:
        if len(lengths) != num_learners:
            message = f"lengths: found {len(lengths)}, expected one per learner, {num_learners}"
            raise ValueError(message)
        observed = [np.atleast_1d(np.asarray(values, dtype=np.float64)) for values in lengths]
        if not all(values.size and np.isfinite(values).all() for values in observed):
            message = "lengths: found an empty array or a number that is not finite, expected finite numbers"
            raise ValueError(message)
        self._pool = np.concatenate(observed)
        self._size: NDArray[np.int64] = np.array([values.size for values in observed])
        self._first = np.cumsum(self._size) - self._size
        self._draws = draws

    def draw(self, selected: Learners) -> Floats:
        """``float64[chains]``."""
        size = self._size[selected]
        return self._pool[self._first[selected] + (self._draws.random(len(selected)) * size).astype(np.intp)]
