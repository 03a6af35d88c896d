"""Layer normalisation (Ba, Kiros & Hinton 2016) without learned gain and bias, which it does not need (Xu et al. 2019,
*Understanding and Improving Layer Normalization*).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from apel.learners.deep.layer_table import NORMAL, OUTPUTS, ROOM, filled
from apel.learners.deep.products import LANES, Floats, sum_of_squares
from apel.numerics.compiled import njit

EPSILON = 1e-5
"""Added to the variance, as in PyTorch."""


@njit
def normalise(count: int, layer: NDArray[np.int64], activations: Floats, normalised: Floats) -> None:
    """Shift and scale the outputs of each example to a mean of 0 and a variance of 1; they, and the scale behind them,
    stay in ``normalised``.
    """
    outputs, width = layer[OUTPUTS], filled(layer[OUTPUTS])
    for b in range(count):
        at, kept = count * layer[ROOM] + b * width, count * layer[NORMAL] + b * (width + LANES)
        values, room = activations[at : at + width], normalised[kept : kept + width + LANES]
        total = np.float32(0.0)
        for j in range(outputs):
            total += values[j]
        mean = total / np.float32(outputs)
        for j in range(outputs):
            values[j] -= mean
        variance = sum_of_squares(values, 0, width) / np.float32(outputs)
        scale = np.float32(1.0 / math.sqrt(np.float64(variance) + EPSILON))
        for j in range(width):
            values[j] *= scale
            room[j] = values[j]
        room[width] = scale


@njit
def denormalise(count: int, layer: NDArray[np.int64], normalised: Floats, deltas: Floats) -> None:
    """The gradient in what was normalised: scale · (d − mean d − y · mean(d · y))."""
    outputs, width = layer[OUTPUTS], filled(layer[OUTPUTS])
    for b in range(count):
        at, kept = count * layer[ROOM] + b * width, count * layer[NORMAL] + b * (width + LANES)
        slope, room = deltas[at : at + width], normalised[kept : kept + width + LANES]
        total, along = np.float32(0.0), np.float32(0.0)
        for j in range(outputs):
            total += slope[j]
            along += slope[j] * room[j]
        mean, share = total / np.float32(outputs), along / np.float32(outputs)
        for j in range(outputs):
            slope[j] = room[width] * (slope[j] - mean - room[j] * share)
