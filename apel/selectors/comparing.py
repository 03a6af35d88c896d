"""How the performances of one learner stand to those of another: by ranks, and by their own deviation."""

from __future__ import annotations

import math

import numpy as np

from apel.numerics.compiled import njit
from apel.numerics.views import Row


@njit
def score(performance: float, reference: Row) -> float:
    """P(performance > X) − P(performance < X) for X of ``reference``, ``float64[m]``."""
    difference = 0
    for i in range(reference.shape[0]):
        if performance > reference[i]:
            difference += 1
        elif performance < reference[i]:
            difference -= 1
    return difference / reference.shape[0]


@njit
def deviations_behind(few: Row, reference: Row, most: float) -> float:
    """(Median of ``reference`` − mean of ``few``)/their standard deviation, from 1 to ``most``; 1 where few are one."""
    count = few.shape[0]
    if count == 1:
        return 1.0
    ordered = np.sort(reference)
    median = 0.5 * ordered[(ordered.shape[0] - 1) // 2] + 0.5 * ordered[ordered.shape[0] // 2]
    mean, variance = 0.0, 0.0
    for i in range(count):
        mean += few[i] / count
    for i in range(count):
        variance += (few[i] - mean) * (few[i] - mean) / (count - 1)
    if not median > mean:
        return 1.0
    if variance == 0.0:
        return most
    behind = (median - mean) / math.sqrt(variance)
    return min(behind, most) if behind > 1.0 else 1.0  # no number, after an overflow of both, is as good as nothing


@njit
def are_tied(few: Row, reference: Row) -> bool:
    """Whether all of ``few`` and ``reference`` are one and the same number."""
    return bool((few == reference[0]).all() and (reference == reference[0]).all())
