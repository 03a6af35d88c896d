"""Two arms against each other: run by run, since runs of one index play the same maze and seed, and as two samples.

Source: Agarwal, R. et al. (2021), *Deep reinforcement learning at the edge of the statistical precipice*, NeurIPS;
Mann, H. B. & Whitney, D. R. (1947), *On a test of whether one of two random variables is stochastically larger than the
other*, Annals of Mathematical Statistics 18(1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import scipy
from numpy.typing import NDArray

from apel.numerics.intervals import expanded_levels
from jobs.analysis.statistics.bootstrap import (
    NUM_RESAMPLES,
    Estimate,
    Floats,
    bootstrap_curve,
    require_finite,
)

# Comparisons per batch of resamples, one byte each.
_BATCH_COMPARISONS = 200_000


@dataclass(frozen=True)
class PairedComparison:
    """What the same runs say of two arms.

    Attributes
    ----------
    difference:
        Mean of the first minus mean of the second.
    share_less:
        Share of runs in which the first is the smaller, whichever is better; ties count nothing.
    win_probability:
        Share of runs in which the first is the better; ties count half.
    """

    difference: Estimate[float]
    share_less: float
    win_probability: Estimate[float]


def compare_paired(
    first: Floats,
    second: Floats,
    *,
    smaller_is_better: bool,
    num_resamples: int = NUM_RESAMPLES,
    seed: int = 0,
) -> PairedComparison:
    """Compare ``float64[runs]`` with ``float64[runs]`` run by run; the pairs are resampled.

    Where every run says the same, the interval is a point: it tells of these runs' agreement, not of certainty.

    Raises
    ------
    ValueError
        If the lengths differ or a value is not finite.
    """
    if first.shape != second.shape or first.ndim != 1:
        msg = f"found runs of shapes {first.shape} and {second.shape}, expected as many of each, in pairs"
        raise ValueError(msg)
    columns = np.stack((first - second, _wins(first, second, smaller_is_better=smaller_is_better)), axis=1)
    both = bootstrap_curve(columns, num_resamples=num_resamples, seed=seed)
    difference, win = (Estimate(*(float(part[column]) for part in both)) for column in range(2))
    return PairedComparison(difference, float(np.mean(first < second)), win)


def probability_of_improvement(
    first: Floats,
    second: Floats,
    *,
    smaller_is_better: bool,
    num_resamples: int = NUM_RESAMPLES,
    seed: int = 0,
) -> Estimate[float]:
    """P(X better than Y) + ½ P(X = Y) for a run X of the first and an independent run Y of the second arm.

    This is Mann and Whitney's U / (n m). Each arm ``float64[runs]`` is resampled on its own; the numbers of runs may
    differ.

    Raises
    ------
    ValueError
        If an arm has no run, or a value is not finite.
    """
    for values in (first, second):
        require_finite(values)

    def statistic(x: Floats, y: Floats, axis: int = -1) -> Floats:  # noqa: ARG001
        better, other = (y, x) if smaller_is_better else (x, y)
        pairs = better[..., :, None], other[..., None, :]
        return 0.5 * (np.greater(*pairs).mean(axis=(-1, -2)) + np.greater_equal(*pairs).mean(axis=(-1, -2)))

    value = float(statistic(first, second))
    if min(len(first), len(second)) < 2:
        return Estimate(value, value, value)
    lowest, highest = expanded_levels(min(len(first), len(second)))
    interval = scipy.stats.bootstrap(
        (first, second),
        statistic,
        vectorized=True,
        n_resamples=num_resamples,
        batch=max(1, _BATCH_COMPARISONS // (len(first) * len(second))),
        confidence_level=highest - lowest,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return Estimate(value, float(interval.low), float(interval.high))


def aligned(runs: pa.Table, column: str, points: Sequence[tuple[str, str]]) -> Floats:
    """Values of one column side by side, ``float64[runs, points]``: a row holds the runs of one index.

    Parameters
    ----------
    runs:
        Run rows with ``arm``, ``sweep``, ``run_index`` and the column.
    column:
        Such as ``train_time``.
    points:
        Arm and sweep point of each column of the result. Runs that are missing in one of them are left out of all.

    Raises
    ------
    ValueError
        If a point has no runs or one of them twice, the points have none in common, or a value is null.
    """
    frame = runs.select(["arm", "sweep", "run_index", column]).to_pandas()
    found = {point: group.set_index("run_index")[column] for point, group in frame.groupby(["arm", "sweep"])}
    if missing := [point for point in points if point not in found]:
        msg = f"found no runs of {missing}, expected arms and sweep points among {sorted(found)}"
        raise ValueError(msg)
    columns = [found[point] for point in points]
    if not all(values.index.is_unique for values in columns):
        msg = "found a run index twice in an arm and sweep point, expected the runs of one experiment"
        raise ValueError(msg)
    common = sorted(set.intersection(*(set(values.index) for values in columns)))
    if not common:
        msg = f"found no run index that all of {list(points)} have, expected the same runs of each"
        raise ValueError(msg)
    values: NDArray[np.float64] = np.stack([part.loc[common].to_numpy(np.float64) for part in columns], axis=1)
    require_finite(values)
    return values


def _wins(first: Floats, second: Floats, *, smaller_is_better: bool) -> Floats:
    """1 where the first is better, ½ where they are equal, else 0."""
    sign = -1.0 if smaller_is_better else 1.0
    return (1 + sign * np.sign(first - second)) / 2
