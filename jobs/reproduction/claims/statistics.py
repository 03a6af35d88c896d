"""The statistics that claims are made of: a quantity at each point of an axis, and what is said of it over the points.

Runs of one index share maze and seed, so all arms and points of a run are resampled together (Efron 1979). The
resamples are drawn as counts, how often each run is in: means and variances of all of them are then one product of
matrices.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from jobs.analysis.statistics.bootstrap import NUM_RESAMPLES, Floats
from jobs.reproduction.claims.resampled import Resampled
from jobs.reproduction.claims.theories import THEORIES, Setting

_SEED = 0
# Resampled numbers per batch where each resample has to be sorted.
_BATCH_NUMBERS = 2_000_000


@dataclass(frozen=True)
class Sample:
    """What a claim is about.

    Attributes
    ----------
    values:
        ``float64[runs, arms, points]``.
    axis:
        ``float64[points]``.
    """

    values: Floats
    axis: Floats


@dataclass(frozen=True)
class Moments:
    """Location and standard deviation over the runs, ``float64[…, arms, points]`` each."""

    location: Floats
    deviation: Floats


QUANTITIES: dict[str, Callable[[Moments], Floats]] = {
    "mean": lambda m: m.location[..., 0, :],
    "deviation": lambda m: m.deviation[..., 0, :],
    "difference": lambda m: m.location[..., 0, :] - m.location[..., 1, :],
    "ratio": lambda m: m.location[..., 0, :] / m.location[..., 1, :],
    "deviation_ratio": lambda m: m.deviation[..., 0, :] / m.deviation[..., 1, :],
}
"""Of one arm or of the first against the second, at every point."""

AGAINST_THEORY: dict[str, Callable[[Floats, Floats], Floats]] = {
    "theory_difference": lambda measured, predicted: measured - predicted,
    "theory_ratio": lambda measured, predicted: measured / predicted,
}


def _trend(values: Floats, axis: Floats) -> Floats:
    """Spearman's rank correlation with the axis; 0 where all values are equal."""
    ranks = scipy.stats.rankdata(values, axis=-1) - (len(axis) + 1) / 2
    of_axis = scipy.stats.rankdata(axis) - (len(axis) + 1) / 2
    norm = np.sqrt(np.sum(ranks**2, axis=-1) * np.sum(of_axis**2))
    return np.divide(ranks @ of_axis, norm, out=np.zeros_like(norm), where=norm > 0)


def _slope(values: Floats, axis: Floats) -> Floats:
    """Least squares, per unit of the axis."""
    centred = axis - axis.mean()
    return (values @ centred) / np.sum(centred**2)


def _relative_change(values: Floats, axis: Floats) -> Floats:
    """What the fitted line gains from one end of the axis to the other, by the mean of all points' sizes."""
    return _slope(values, axis) * np.ptp(axis) / np.abs(values.mean(axis=-1))


def _linearity(values: Floats, axis: Floats) -> Floats:
    """R² of the least-squares line; 1 where all values are equal."""
    centred = values - values.mean(axis=-1, keepdims=True)
    explained = _slope(values, axis) ** 2 * np.sum((axis - axis.mean()) ** 2)
    total = np.sum(centred**2, axis=-1)
    return np.divide(explained, total, out=np.ones_like(total), where=total > 0)


SUMMARIES: dict[str, Callable[[Floats, Floats], Floats]] = {
    "only": lambda values, _: values[..., 0],
    "smallest": lambda values, _: values.min(axis=-1),
    "largest": lambda values, _: values.max(axis=-1),
    "spread": lambda values, _: values.max(axis=-1) / values.min(axis=-1),
    "rise": lambda values, _: values[..., -1] - values[..., 0],
    "growth": lambda values, _: values[..., -1] / values[..., 0],
    "gap": lambda values, _: np.abs(values - 1).max(axis=-1),
    "rising": lambda values, _: (np.diff(values, axis=-1) > 0).mean(axis=-1),
    "trend": _trend,
    "slope": _slope,
    "relative_change": _relative_change,
    "linearity": _linearity,
    "excess": lambda values, _: values[..., :1] - values[..., 1:],
}
"""From values ``[…, points]`` and the axis to ``[…]``; rise and growth are of the last point over the first. The excess
is that of the first point over each of the others, ``[…, comparisons]``, of which the largest counts."""


def resampled(sample: Sample, statistic: Callable[[Moments], Floats], *, median: bool = False) -> Resampled:
    """A statistic of the arms' and points' moments: ``float64[…]``, or ``float64[…, comparisons]``."""
    num_runs = len(sample.values)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(np.max(statistic(_moments(sample.values, np.ones((1, num_runs)), median=median))))
        drawn = statistic(_moments(sample.values, _counts(num_runs), median=median))
    return Resampled(value, drawn.reshape(NUM_RESAMPLES, -1), num_runs)


def measured(sample: Sample, quantity: str, over: str, *, median: bool = False) -> Resampled:
    """One of `QUANTITIES` at each point, in one of `SUMMARIES`."""
    of, summary = QUANTITIES[quantity], SUMMARIES[over]
    return resampled(sample, lambda moments: summary(of(moments), sample.axis), median=median)


def against_theory(sample: Sample, quantity: str, over: str, theory: str, setting: Setting) -> Resampled:
    """The first arm's mean against one of `THEORIES` at each point, in one of `SUMMARIES`."""
    compare, predict, summary = AGAINST_THEORY[quantity], THEORIES[theory], SUMMARIES[over]
    return resampled(
        sample,
        lambda m: summary(compare(m.location[..., 0, :], predict(setting, m.location)), sample.axis),
    )


@lru_cache(maxsize=4)
def _counts(num_runs: int) -> Floats:
    """``float64[resamples, runs]``: how often each run is drawn."""
    draws = np.random.default_rng(_SEED)
    return draws.multinomial(num_runs, np.full(num_runs, 1 / num_runs), NUM_RESAMPLES).astype(np.float64)


def _moments(values: Floats, counts: Floats, *, median: bool) -> Moments:
    """Of each resample; centred first, so that equal values have exactly their mean, and no spread."""
    num_runs, shape = len(values), (len(counts), *values.shape[1:])
    columns = values.reshape(num_runs, -1)
    middle = columns.mean(axis=0)
    middle = np.where((columns == columns[0]).all(axis=0), columns[0], middle)
    centred = columns - middle
    shift = counts @ centred / num_runs
    variance = np.maximum(counts @ centred**2 / num_runs - shift**2, 0.0) * num_runs / max(num_runs - 1, 1)
    location = _medians(columns, counts) if median else middle + shift
    return Moments(location.reshape(shape), np.sqrt(variance).reshape(shape))


def _medians(columns: Floats, counts: Floats) -> Floats:
    found = np.empty((len(counts), columns.shape[1]))
    batch = max(1, _BATCH_NUMBERS // columns.size)
    runs = np.arange(len(columns))
    for first in range(0, len(counts), batch):
        part = counts[first : first + batch].astype(np.int64)
        drawn = np.repeat(np.tile(runs, len(part)), part.ravel()).reshape(len(part), len(runs))
        found[first : first + batch] = np.median(columns[drawn], axis=1)
    return found
