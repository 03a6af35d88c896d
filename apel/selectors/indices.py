"""What index rules share: confidence bounds, and the draw among the learners whose index is largest."""

from __future__ import annotations

import math

import numpy as np

from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, integer, uniform
from apel.numerics.views import Row


@njit
def upper_confidence_bounds(
    exploration: float, total: float, count: Row, performance_sum: Row, low: float, high: float, index: Row
) -> None:
    """Write x̄ₖ + √(ξ ln n / nₖ) into ``index``, ``float64[learners]``; +∞ for a learner that was not tried.

    Means are mapped affinely from [``low``, ``high``] to [0, 1]: 0 and 1 leave them, bit for bit, as they are.
    """
    logarithm = math.log(total) if total > 1.0 else 0.0
    span = high - low if high > low else 1.0
    for k in range(index.shape[0]):
        index[k] = np.inf
        if count[k] > 0.0:
            mean = (performance_sum[k] / count[k] - low) / span
            index[k] = mean + math.sqrt(exploration * logarithm / count[k])


@njit
def pick_largest(index: Row, stream: Stream) -> int:
    """Draw uniformly among the learners of the largest index; ``index`` becomes the probabilities of that draw."""
    best, num_best = -np.inf, 0
    for k in range(index.shape[0]):
        if math.isnan(index[k]):  # an overflow of the sums: never preferred, but there is always a learner to take
            index[k] = -np.inf
        if index[k] > best:
            best, num_best = index[k], 1
        elif index[k] == best:
            num_best += 1
    pick = integer(stream, num_best)
    selected = 0
    for k in range(index.shape[0]):
        if index[k] == best:
            if pick == 0:
                selected = k
            pick -= 1
            index[k] = 1.0 / num_best
        else:
            index[k] = 0.0
    return selected


@njit
def pick_largest_or_any(epsilon: float, index: Row, stream: Stream) -> int:
    """With probability ε any learner, else `pick_largest`; ``index`` becomes the probabilities of both together."""
    num_learners = index.shape[0]
    explores = uniform(stream) < epsilon
    selected = pick_largest(index, stream)
    for k in range(num_learners):
        index[k] = (1.0 - epsilon) * index[k] + epsilon / num_learners
    return integer(stream, num_learners) if explores else selected
