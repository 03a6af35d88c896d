"""Runs as survivors: which share of them is solved by which episode, where some never are.

A run that reaches the cap unsolved is censored there: its train time is longer than the cap, by how much is unknown.
The product-limit estimate counts it as unsolved for as long as it was watched.

Source: Kaplan, E. L. & Meier, P. (1958), *Nonparametric estimation from incomplete observations*, JASA 53(282).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from apel.numerics.intervals import CONFIDENCE
from jobs.analysis.statistics.bootstrap import Estimate, Floats, require_finite

# Products of (at risk − solved) / at risk miss one half by rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class SolvedShare:
    """A step function from 0 on: from each of ``episodes`` until the next, this share of the runs is solved.

    Attributes
    ----------
    episodes:
        ``float64[steps]``, rising; 0, and then every train time.
    share:
        ``float64[steps]`` in [0, 1], never falling.
    low, high:
        ``float64[steps]``: pointwise 95 % band around ``share``.
    """

    episodes: Floats
    share: Floats
    low: Floats
    high: Floats

    def at(self, episodes: Floats) -> Estimate[Floats]:
        """The share and its band at any episodes ≥ 0."""
        step = np.searchsorted(self.episodes, episodes, side="right") - 1
        return Estimate(self.share[step], self.low[step], self.high[step])


def share_solved(train_time: Floats, censored: NDArray[np.bool_]) -> SolvedShare:
    """Share of runs solved by episode: 1 − S(t), S(t) = Π (1 − dᵢ / nᵢ) over the train times tᵢ ≤ t.

    dᵢ runs are solved at tᵢ, of nᵢ neither solved nor censored before. The band is the exponential Greenwood interval,
    which stays in [0, 1]; where nothing or everything is solved it is undefined, and the exact binomial interval takes
    its place (Clopper & Pearson 1934).

    Parameters
    ----------
    train_time:
        ``float64[runs]`` in episodes; for a censored run how long it was watched.
    censored:
        ``bool[runs]``: stopped before it was solved.

    Raises
    ------
    ValueError
        If there is no run, a time is negative or not finite, or the lengths differ.
    """
    times, flags = np.asarray(train_time, dtype=np.float64), np.asarray(censored, dtype=np.bool_)
    require_finite(times)
    if times.shape != flags.shape or times.ndim != 1:
        msg = f"found times {times.shape} and flags {flags.shape}, expected one of each per run"
        raise ValueError(msg)
    if np.any(times < 0):
        msg = f"found a train time of {times.min():g}, expected none below 0"
        raise ValueError(msg)
    survival = scipy.stats.ecdf(scipy.stats.CensoredData.right_censored(times, flags)).sf
    share = 1 - survival.probabilities
    low, high = _greenwood(survival)
    for step in np.flatnonzero((survival.probabilities == 0) | (survival.probabilities == 1)):
        at_risk = int(np.sum(times >= survival.quantiles[step]))
        low[step], high[step] = _exact(0, at_risk) if share[step] == 0 else _exact(1, int(np.sum(~flags)))
    return _from_zero(survival.quantiles, share, low, high, len(times))


def median_train_time(train_time: Floats, censored: NDArray[np.bool_]) -> Estimate[float]:
    """First episode by which half of the runs are solved, and 95 % interval; ``inf`` where that was not seen.

    The interval is where the band of :func:`share_solved` crosses one half (Brookmeyer & Crowley 1982). Of an
    even number of runs this is the lower of the two middle times, not their mean.

    >>> median_train_time(np.array([10.0, 20.0, 40.0, 40.0]), np.array([False, False, True, True])).value
    20.0
    """
    curve = share_solved(train_time, censored)
    value, low, high = (_first(curve, edge) for edge in (curve.share, curve.high, curve.low))
    return Estimate(value, low, high)


def _greenwood(survival: Any) -> tuple[Floats, Floats]:
    """Band of the share solved; NaN where S is 0 or 1."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        band = survival.confidence_interval(CONFIDENCE, method="log-log")
    return 1 - band.high.probabilities, 1 - band.low.probabilities


def _exact(share: int, num_runs: int) -> tuple[float, float]:
    """Interval of a share of none (0) or all (1) of the runs."""
    interval = scipy.stats.binomtest(share * num_runs, num_runs).proportion_ci(CONFIDENCE, method="exact")
    return float(interval.low), float(interval.high)


def _from_zero(episodes: Floats, share: Floats, low: Floats, high: Floats, num_runs: int) -> SolvedShare:
    """Add the step before the first train time, where nothing is solved."""
    if episodes[0] == 0:
        return SolvedShare(episodes, share, low, high)
    low_at_zero, high_at_zero = _exact(0, num_runs)
    columns = ((0.0, episodes), (0.0, share), (low_at_zero, low), (high_at_zero, high))
    return SolvedShare(*(np.concatenate(([first], rest)) for first, rest in columns))


def _first(curve: SolvedShare, edge: Floats) -> float:
    reached = np.flatnonzero(edge >= 0.5 - _ROUNDING)
    return float(curve.episodes[reached[0]]) if len(reached) else float("inf")
