"""Who is the best of several candidates, by bootstrap over runs, those of one index drawn together.

Source: Efron, B. & Tibshirani, R. J. (1993), *An introduction to the bootstrap*; Agarwal, R. et al. (2021), *Deep
reinforcement learning at the edge of the statistical precipice*, NeurIPS.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jobs.analysis.statistics.bootstrap import NUM_RESAMPLES, Floats

NEAR = 0.05
"""Within this share of the best mean a candidate is nearly as good."""
_BATCH_NUMBERS = 2_000_000


class Standing(NamedTuple):
    """Of each candidate, ``float64[candidates]``.

    Attributes
    ----------
    best:
        Share of resamples in which its mean is the best; equal ones share it.
    near:
        Share in which its mean is within 5 % of the best one's, that is of its amount: −84 is within 5 % of −80.
    """

    best: Floats
    near: Floats


def standing(values: Floats, *, smaller_is_better: bool, num_resamples: int = NUM_RESAMPLES, seed: int = 0) -> Standing:
    """How often each candidate is the best, and nearly the best, if the runs are drawn anew.

    Parameters
    ----------
    values:
        ``float64[runs, candidates]``; NaN where a candidate has no value of a run. A resample draws runs, and each mean
        is that of the drawn ones which the candidate has; without any it is the worst.
    smaller_is_better:
        As train times are.
    num_resamples, seed:
        How many are drawn, and of which generator.

    >>> standing(np.array([[3.0, 1.0], [4.0, 2.0]]), smaller_is_better=False).best
    array([1., 0.])
    """
    num_runs = len(values)
    costs = values if smaller_is_better else -values
    is_known = np.isfinite(costs)
    filled, known = np.where(is_known, costs, 0.0), is_known.astype(np.float64)
    rng = np.random.default_rng(seed)
    best, near = np.zeros(values.shape[1]), np.zeros(values.shape[1])
    batch = max(1, _BATCH_NUMBERS // max(num_runs, values.shape[1]))
    for begin in range(0, num_resamples, batch):
        size = min(batch, num_resamples - begin)
        drawn = rng.multinomial(num_runs, np.full(num_runs, 1 / num_runs), size=size).astype(np.float64)
        total, count = drawn @ filled, drawn @ known
        means = np.where(count > 0, total / np.maximum(count, 1.0), np.inf)
        least = means.min(axis=1, keepdims=True)
        is_known_at_all = np.isfinite(least)
        is_best = (means == least) & is_known_at_all
        best += (is_best / np.maximum(is_best.sum(axis=1, keepdims=True), 1)).sum(axis=0)
        near += (is_known_at_all & (means <= least + NEAR * np.abs(np.where(is_known_at_all, least, 0.0)))).sum(axis=0)
    return Standing(best / num_resamples, near / num_resamples)
