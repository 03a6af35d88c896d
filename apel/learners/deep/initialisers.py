"""How the weights of networks begin: the same numbers on every machine."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from apel.numerics.compiled import njit

Shape = Sequence[int]
"""Of a dense layer's weight ``[inputs, outputs]``, of a convolution's ``[filters, channels, height, width]``."""
Initialiser = Callable[[Shape, np.random.Generator], NDArray[np.float32]]


def orthogonal(gain: float) -> Initialiser:
    """Saxe et al. 2014, as OpenAI Baselines initialises its bodies."""

    def initialise(shape: Shape, generator: np.random.Generator) -> NDArray[np.float32]:
        flat = shape[0], math.prod(shape[1:])
        vectors = generator.standard_normal((min(flat), max(flat)))
        _orthonormalise(vectors)
        matrix = vectors if flat[0] <= flat[1] else vectors.T
        return (gain * matrix).astype(np.float32).reshape(shape)

    return initialise


@njit
def _orthonormalise(vectors: NDArray[np.float64]) -> None:
    """The rows, by Gram and Schmidt's process, twice, so that rounding leaves nothing."""
    for i in range(vectors.shape[0]):
        for _ in range(2):
            for j in range(i):
                overlap = 0.0
                for k in range(vectors.shape[1]):
                    overlap += vectors[i, k] * vectors[j, k]
                for k in range(vectors.shape[1]):
                    vectors[i, k] -= overlap * vectors[j, k]
        total = 0.0
        for k in range(vectors.shape[1]):
            total += vectors[i, k] * vectors[i, k]
        for k in range(vectors.shape[1]):
            vectors[i, k] /= math.sqrt(total)


def glorot(shape: Shape, generator: np.random.Generator) -> NDArray[np.float32]:
    """Glorot & Bengio 2010, the uniform form: TensorFlow's default, and so that of Baselines' heads."""
    field = math.prod(shape[2:])
    return _uniform(math.sqrt(6.0 / (field * (shape[0] + shape[1]))), shape, generator)


def fan_in_uniform(fan_in: int) -> Initialiser:
    """PyTorch's default: uniform on ±1 / √``fan_in``, for weights and biases."""
    return lambda shape, generator: _uniform(fan_in**-0.5, shape, generator)


def zeros(shape: Shape, generator: np.random.Generator) -> NDArray[np.float32]:
    """For biases."""
    return np.zeros(shape, dtype=np.float32)


def side_by_side(one: Initialiser) -> Initialiser:
    """Of two heads, each by itself."""

    def initialise(shape: Shape, generator: np.random.Generator) -> NDArray[np.float32]:
        half = *shape[:-1], shape[-1] // 2
        return np.concatenate([one(half, generator), one(half, generator)], axis=-1)

    return initialise


def _uniform(bound: float, shape: Shape, generator: np.random.Generator) -> NDArray[np.float32]:
    return (bound * (2.0 * generator.random(tuple(shape)) - 1.0)).astype(np.float32)
