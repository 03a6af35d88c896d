"""Networks of one run each, compiled: values, gradients, and steps, without a neighbour and without an allocation.

A network is a few layers in order, each of which reads the input or an earlier layer (`layer_table`); some are heads,
and write columns of the outputs. All parameters of a run are one row. Nothing here knows how many runs there are.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import float32, float64, int32, int64, void
from numpy.typing import NDArray

from apel.learners.deep.arithmetic import power, tanh32
from apel.learners.deep.layer_table import (
    ACTIVATION,
    BIAS,
    COLUMN,
    INPUTS,
    MAP,
    NORMAL,
    OUTPUTS,
    PATCHES,
    PLACES,
    RELU,
    ROOM,
    SOURCE,
    TANH,
    WEIGHT,
    Layers,
    Maps,
    filled,
)
from apel.learners.deep.normalising import denormalise, normalise
from apel.learners.deep.patches import gather, scatter
from apel.learners.deep.products import LANES, Floats, multiply, rectify, sum_of_squares
from apel.numerics.compiled import KernelFunction, caller_of, njit

_BETA_1, _BETA_2 = 0.9, 0.999  # Kingma & Ba 2015

# Loops go over slices, from 0 on: whether an index is below 0, and so counts from the end, need not be asked then.


@njit(inline="always")
def _activate(kind: int, values: Floats) -> None:
    if kind == TANH:
        for i in range(values.shape[0]):
            values[i] = tanh32(values[i])
    elif kind == RELU:
        rectify(values, 0, values.shape[0])


@njit(inline="always")
def _source(
    layers: Layers, layer: NDArray[np.int64], count: int, inputs: Any, activations: Floats
) -> tuple[Any, int, int]:
    """What a layer reads: the array, where the first of ``count`` examples begins in it, and how far they are apart."""
    if layer[SOURCE] < 0:
        return inputs.reshape(inputs.size), 0, inputs.shape[1]
    before = layers[layer[SOURCE]]
    return activations, count * before[ROOM], before[PLACES] * filled(before[OUTPUTS])


def _forward(
    layers: Layers,
    maps: Maps,
    dueling: bool,
    row: Floats,
    inputs: Any,
    activations: Floats,
    patches: Floats,
    normalised: Floats,
    outputs: Any,
) -> None:
    """Outputs ``float32[B, outputs]`` of ``inputs`` ``float32[B, inputs]``; what `_backward` needs stays in the rooms.

    With ``dueling`` the last output of the heads is V, the others A, and the outputs V + A − mean A (Wang et al. 2016).
    """
    count = inputs.shape[0]
    for i in range(layers.shape[0]):
        layer = layers[i]
        width, at, size = filled(layer[OUTPUTS]), count * layer[ROOM], count * layer[PLACES]
        source, source_at, stride = _source(layers, layer, count, inputs, activations)
        depth, weight, bias = layer[INPUTS], layer[WEIGHT], layer[BIAS]
        if layer[MAP] >= 0:
            gather(count, layer, maps, source, source_at, stride, patches)
            source, source_at, stride = patches, count * layer[PATCHES], filled(depth)
        multiply(
            size, depth, width, source, source_at, stride, 1, row, weight, width, row, bias, 0, activations, at, width
        )
        if layer[NORMAL] >= 0:
            normalise(count, layer, activations, normalised)
        _activate(layer[ACTIVATION], activations[at : at + size * width])
        if layer[COLUMN] >= 0:
            for b in range(count):
                for j in range(min(layer[OUTPUTS], outputs.shape[1] - layer[COLUMN])):
                    outputs[b, layer[COLUMN] + j] = activations[at + b * width + j]
    if dueling:
        _join_dueling(layers[layers.shape[0] - 1], activations, outputs)


@njit(inline="always")
def _join_dueling(value: NDArray[np.int64], activations: Floats, outputs: Any) -> None:
    """Of advantages in ``outputs``, and the value in the last layer."""
    count, num_actions = outputs.shape
    for b in range(count):
        mean = np.float32(0.0)
        for j in range(num_actions):
            mean += outputs[b, j]
        shift = activations[count * value[ROOM] + b * filled(value[OUTPUTS])] - mean / np.float32(num_actions)
        for j in range(num_actions):
            outputs[b, j] += shift


@njit(inline="always")
def _head_gradient(layer: NDArray[np.int64], dueling: bool, gradient: Any, deltas: Floats) -> None:
    """Write what ``gradient`` ``[B, outputs]`` is at a head."""
    count, width = gradient.shape[0], filled(layer[OUTPUTS])
    num_actions = np.float32(gradient.shape[1])
    for b in range(count):
        total = np.float32(0.0)
        for j in range(gradient.shape[1]):
            total += gradient[b, j]
        at = count * layer[ROOM] + b * width
        for j in range(layer[OUTPUTS]):
            if dueling:
                deltas[at + j] = total if layer[COLUMN] > 0 else gradient[b, j] - total / num_actions
            else:
                deltas[at + j] = gradient[b, layer[COLUMN] + j]


@njit(inline="always")
def _differentiate(kind: int, values: Floats, deltas: Floats) -> None:
    """Through an activation with these ``values``."""
    if kind == TANH:
        for i in range(values.shape[0]):
            deltas[i] *= np.float32(1.0) - values[i] * values[i]
    elif kind == RELU:
        for i in range(values.shape[0]):
            deltas[i] = deltas[i] if values[i] > np.float32(0.0) else np.float32(0.0)


@njit(inline="always")
def _transpose(weights: Floats, rows: int, columns: int, room: Floats) -> int:
    """Weights ``[rows, columns]`` as ``[columns, rows]``, both filled up; the width of the latter."""
    width, stride = filled(rows), filled(columns)
    given, turned = weights[: rows * stride].reshape((rows, stride)), room[: columns * width].reshape((columns, width))
    for top in range(0, width, LANES):  # block by block, so that what is read and what is written stays near
        count = min(LANES, rows - top)
        for j in range(columns):
            for i in range(count):
                turned[j, top + i] = given[top + i, j]
            for i in range(count, LANES):
                turned[j, top + i] = np.float32(0.0)
    return width


def _backward(
    layers: Layers,
    maps: Maps,
    dueling: bool,
    row: Floats,
    inputs: Any,
    activations: Floats,
    patches: Floats,
    normalised: Floats,
    output_gradient: Any,
    deltas: Floats,
    transposed: Floats,
    gradient: Floats,
) -> None:
    """The gradient ``float32[P]`` of the row, of Σ ``output_gradient`` · outputs, after `_forward` of the same, of
    which nothing is left in ``patches``.
    """
    count = inputs.shape[0]
    last = layers[layers.shape[0] - 1]
    deltas[: count * (last[ROOM] + filled(last[OUTPUTS]))] = np.float32(0.0)
    one = transposed.shape[0] - LANES  # before it there are zeros
    for i in range(layers.shape[0] - 1, -1, -1):
        layer = layers[i]
        width, at, size = filled(layer[OUTPUTS]), count * layer[ROOM], count * layer[PLACES]
        if layer[COLUMN] >= 0:
            _head_gradient(layer, dueling, output_gradient, deltas)
        _differentiate(layer[ACTIVATION], activations[at : at + size * width], deltas[at : at + size * width])
        if layer[NORMAL] >= 0:
            denormalise(count, layer, normalised, deltas)
        source, source_at, stride = _source(layers, layer, count, inputs, activations)
        depth, weight, bias = layer[INPUTS], layer[WEIGHT], layer[BIAS]
        to_at, step = source_at, stride
        if layer[MAP] >= 0:
            source, source_at, stride = patches, count * layer[PATCHES], filled(depth)
        multiply(
            depth, size, width, source, source_at, 1, stride, deltas, at, width, transposed, one - width, 0, gradient,
            weight, width,
        )  # fmt: skip
        multiply(
            1, size, width, transposed, one, 0, 0, deltas, at, width, transposed, one - width, 0, gradient, bias, width
        )
        if layer[SOURCE] < 0:
            continue
        wide = _transpose(row[weight:], depth, layer[OUTPUTS], transposed)
        if layer[MAP] >= 0:
            multiply(
                size, layer[OUTPUTS], wide, deltas, at, width, 1, transposed, 0, wide, transposed, one - wide, 0,
                patches, source_at, stride,
            )  # fmt: skip
            scatter(count, layer, maps, patches, deltas, to_at, step)
        else:
            multiply(
                count, layer[OUTPUTS], wide, deltas, at, width, 1, transposed, 0, wide, deltas, source_at, stride,
                deltas, source_at, stride,
            )  # fmt: skip


@njit(inline="always")
def _scale(values: Floats, largest: float) -> None:
    norm = np.float32(math.sqrt(sum_of_squares(values, 0, values.shape[0])))
    if norm > np.float32(largest):
        scale = np.float32(largest) / norm
        for i in range(values.shape[0]):
            values[i] *= scale


def _clip(layers: Layers, by_variable: bool, largest: float, gradient: Floats) -> None:
    """Scale the gradient of each variable (TensorFlow's ``clip_by_norm``, as OpenAI Baselines uses it), or all of it
    together, to a norm of at most ``largest``.
    """
    if not by_variable:
        _scale(gradient, largest)
        return
    for i in range(layers.shape[0]):
        width = filled(layers[i, OUTPUTS])
        for begin, size in ((layers[i, WEIGHT], layers[i, INPUTS] * width), (layers[i, BIAS], width)):
            _scale(gradient[begin : begin + size], largest)


@njit
def adam(step: int, rate: float, epsilon: float, gradient: Floats, row: Floats, mean: Floats, square: Floats) -> None:
    """Step number ``step``, counted from 1, of Adam (Kingma & Ba 2015) in one row, with its two moments."""
    share, other_share = np.float32(1.0 - _BETA_1), np.float32(1.0 - _BETA_2)
    kept = np.float32(_BETA_2)
    size = np.float32(rate / (1.0 - power(_BETA_1, step)))
    root = np.float32(1.0 / math.sqrt(1.0 - power(_BETA_2, step)))
    least = np.float32(epsilon)
    for i in range(row.shape[0]):
        g = gradient[i]
        mean[i] += share * (g - mean[i])
        square[i] = kept * square[i] + other_share * g * g
        row[i] -= size * mean[i] / (np.float32(math.sqrt(square[i])) * root + least)


_ROW, _MATRIX = float32[::1], float32[:, ::1]
_LAYERS = int64[:, ::1], int32[::1], int64
_FORWARD = KernelFunction(_forward, void(*_LAYERS, _ROW, _MATRIX, _ROW, _ROW, _ROW, _MATRIX))
_BACKWARD = KernelFunction(_backward, void(*_LAYERS, _ROW, _MATRIX, _ROW, _ROW, _ROW, _MATRIX, _ROW, _ROW, _ROW))
_CLIP = KernelFunction(_clip, void(int64[:, ::1], int64, float64, _ROW))
_ADAM = KernelFunction(adam.py_func, void(int64, float64, float64, _ROW, _ROW, _ROW, _ROW))
call_forward, call_backward = caller_of(_FORWARD), caller_of(_BACKWARD)
call_clip, call_adam = caller_of(_CLIP), caller_of(_ADAM)


class Kernels(NamedTuple):
    """Where the functions lie, the same for every network: so nobody who calls them compiles them anew."""

    forward: int
    backward: int
    clip: int
    adam: int


def kernels() -> Kernels:
    """They are compiled, or found in the cache, with the first call."""
    return Kernels(_FORWARD.address, _BACKWARD.address, _CLIP.address, _ADAM.address)
