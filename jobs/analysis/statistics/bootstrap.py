"""Bootstrap over runs: what a statistic would have been, had the hundred runs been another hundred.

The unit that is resampled is the run. All columns of a run (points of its curve, arms that played its maze) are drawn
together, so that a curve stays a curve and a pair a pair. Intervals are *expanded* percentile intervals at 95 %, which
hold what they are to hold also of a few runs (`apel.numerics.intervals`; docs/statistics.md has how often).

The drawing is :func:`scipy.stats.bootstrap`'s, in batches that fit the cache, with statistics that take many resamples
at once. Every call has a generator of its own: the same values and seed give the same interval.

Source: Efron, B. (1979), *Bootstrap methods: another look at the jackknife*, Annals of Statistics 7(1); Agarwal, R.
et al. (2021), *Deep reinforcement learning at the edge of the statistical precipice*, NeurIPS; Hesterberg, T. C.
(2015), *What teachers should know about the bootstrap*, The American Statistician 69(4).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np
import scipy  # whose `stats`, a second's work to import, it imports itself where it is first used
from numpy.typing import NDArray

from apel.numerics.intervals import expanded_levels

NUM_RESAMPLES = 10_000
# Numbers per batch of resamples: 1.6 MB stay in the cache; 10 000 resamples of a curve at once would take 800 MB.
_BATCH_NUMBERS = 200_000

Floats = NDArray[np.float64]
Location = Literal["mean", "median", "interquartile_mean"]
T_co = TypeVar("T_co", covariant=True)


class Estimate(NamedTuple, Generic[T_co]):
    """A value and its 95 % interval: numbers, or an array each."""

    value: T_co
    low: T_co
    high: T_co


def interquartile_mean(values: Floats) -> float:
    """Mean of the middle half, ``float64[runs]``: ⌊runs / 4⌋ fall away at either end (Agarwal et al. 2021).

    >>> interquartile_mean(np.array([0.0, 1.0, 3.0, 100.0]))
    2.0
    """
    return float(scipy.stats.trim_mean(values, 0.25))


def bootstrap_interval(values: Floats) -> tuple[float, float]:
    """95 % interval of the mean of ``float64[runs]``; a point where all are equal."""
    estimate = bootstrap_curve(values)
    return float(estimate.low), float(estimate.high)


def bootstrap_curve(
    values: Floats, location: Location = "mean", *, num_resamples: int = NUM_RESAMPLES, seed: int = 0
) -> Estimate[Floats]:
    """Location of each column over the runs, with its pointwise interval.

    Parameters
    ----------
    values:
        ``float64[runs, …]``; one resample of the runs serves all columns.
    location:
        ``mean``, ``median`` or ``interquartile_mean``.
    num_resamples, seed:
        How many are drawn, and of which generator.

    Returns
    -------
    Three arrays ``float64[…]``. The interval of a single run, or of equal values, is a point.

    Raises
    ------
    ValueError
        If there is no run, or a value is not finite.
    """
    require_finite(values)
    columns = values.reshape(len(values), -1).T
    point = _LOCATIONS[location](columns)
    if len(values) < 2:
        return Estimate(*(point.reshape(values.shape[1:]) for _ in range(3)))
    interval = _bootstrap(columns, _LOCATIONS[location], columns.size, num_resamples, seed).confidence_interval
    # Summation rounds: the mean of equal values need not be that value.
    is_constant = np.all(columns == columns[:, :1], axis=-1)
    ends = (np.where(is_constant, columns[:, 0], end) for end in (point, interval.low, interval.high))
    return Estimate(*(end.reshape(values.shape[1:]) for end in ends))


def bootstrap_of_runs(
    values: Floats,
    statistic: Callable[[Floats], Floats],
    *,
    num_resamples: int = NUM_RESAMPLES,
    seed: int = 0,
) -> Estimate[float]:
    """Interval of any statistic of several aligned samples, such as the ratio of two arms' standard deviations.

    Parameters
    ----------
    values:
        ``float64[runs, columns]``; a row holds what belongs together, and is drawn as a whole.
    statistic:
        From ``float64[…, runs, columns]`` to ``float64[…]``.
    num_resamples, seed:
        How many are drawn, and of which generator.

    Raises
    ------
    ValueError
        If a value is not finite, or the statistic is not, of the values or of a resample.

    Examples
    --------
    >>> values = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]])
    >>> bootstrap_of_runs(values, lambda runs: runs[..., 1].sum(axis=-1) / runs[..., 0].sum(axis=-1))
    Estimate(value=10.0, low=10.0, high=10.0)
    """
    require_finite(values)
    with np.errstate(divide="ignore", invalid="ignore"), warnings.catch_warnings():
        # What is not finite is told of below.
        warnings.simplefilter("ignore", scipy.stats.DegenerateDataWarning)
        value = float(statistic(values))
        if len(values) < 2:
            return _estimate(value, value, value)
        # The runs' numbers are resampled in place of their rows, so that any statistic sees whole rows.
        numbers, of_numbers = np.arange(len(values)), _of_numbers(values, statistic)
        resampled = _bootstrap(numbers, of_numbers, values.size, num_resamples, seed)
    if num_bad := int(np.sum(~np.isfinite(resampled.bootstrap_distribution))):
        msg = f"found {num_bad} resamples of {num_resamples} whose statistic is not finite, expected none"
        raise ValueError(msg)
    return _estimate(value, *resampled.confidence_interval)


def bootstrap_of_means(
    values: Floats,
    statistic: Callable[[Floats], Floats],
    *,
    num_resamples: int = NUM_RESAMPLES,
    seed: int = 0,
) -> Estimate[float]:
    """Interval of a statistic of column means, such as a ratio of two arms' means or the slope of means over an axis.

    Parameters
    ----------
    values:
        ``float64[runs, columns]``, drawn row by row as in :func:`bootstrap_of_runs`.
    statistic:
        From means ``float64[…, columns]`` to ``float64[…]``.
    num_resamples, seed:
        How many are drawn, and of which generator.
    """
    return bootstrap_of_runs(values, lambda runs: statistic(runs.mean(axis=-2)), num_resamples=num_resamples, seed=seed)


def slope(axis: Floats) -> Callable[[Floats], Floats]:
    """Least-squares slope over ``axis``, a statistic of ``float64[…, columns]``: Σ (xᵢ − x̄) yᵢ / Σ (xᵢ − x̄)².

    >>> float(slope(np.array([1.0, 2.0, 3.0]))(np.array([5.0, 7.0, 9.0])))
    2.0
    """
    centred = np.asarray(axis, dtype=np.float64) - np.mean(axis)
    if not np.any(centred):
        msg = f"found an axis of {len(centred)} equal points, expected at least two different ones"
        raise ValueError(msg)
    weights = centred / np.sum(centred**2)
    return lambda means: means @ weights


def require_finite(values: Floats) -> None:
    """Refuse what cannot be resampled."""
    if len(values) == 0:
        msg = "found no runs, expected at least one"
        raise ValueError(msg)
    num_bad = int(np.sum(~np.isfinite(values)))
    if num_bad:
        msg = f"found {num_bad} of {np.size(values)} values that are not finite, expected a number for every run"
        raise ValueError(msg)


def _of_numbers(values: Floats, statistic: Callable[[Floats], Floats]) -> Callable[[NDArray[np.int64], int], Floats]:
    """The statistic as a function of which runs are drawn, ``int64[resamples, runs]``."""

    def of_numbers(drawn: NDArray[np.int64], axis: int) -> Floats:  # noqa: ARG001
        found = np.asarray(statistic(values[drawn]))
        if found.shape != drawn.shape[:-1]:
            msg = f"found a statistic of shape {found.shape}, expected one number for each of {len(drawn)} resamples"
            raise ValueError(msg)
        return found

    return of_numbers


def _estimate(value: float, low: float, high: float) -> Estimate[float]:
    if not np.isfinite(value):
        msg = f"found a statistic of {value} of the values, expected a finite number"
        raise ValueError(msg)
    return Estimate(value, float(low), float(high))


def _bootstrap(sample: Any, statistic: Any, numbers_per_resample: int, num_resamples: int, seed: int) -> Any:
    """By scipy, of ``[…, runs]``."""
    low, high = expanded_levels(sample.shape[-1])
    return scipy.stats.bootstrap(
        (sample,),
        statistic,
        axis=-1,
        vectorized=True,
        n_resamples=num_resamples,
        batch=max(1, _BATCH_NUMBERS // numbers_per_resample),
        confidence_level=high - low,
        method="percentile",
        rng=np.random.default_rng(seed),
    )


def _mean(values: Floats, axis: int = -1) -> Floats:
    return np.mean(values, axis=axis)


def _median(values: Floats, axis: int = -1) -> Floats:
    return _mean_of_middle(values, (values.shape[axis] - 1) // 2)


def _interquartile_mean(values: Floats, axis: int = -1) -> Floats:
    return _mean_of_middle(values, values.shape[axis] // 4)


def _mean_of_middle(values: Floats, num_cut: int) -> Floats:
    """Trimmed mean over the last axis; a full sort is vectorised, and faster than scipy's partition."""
    return np.sort(values, axis=-1)[..., num_cut : values.shape[-1] - num_cut].mean(axis=-1)


_LOCATIONS = {"mean": _mean, "median": _median, "interquartile_mean": _interquartile_mean}
