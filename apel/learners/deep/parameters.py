"""Where the variables of a network lie in a row of parameters, and what they are at first.

The parameters of one run are one row ``float32[P]``, those of R runs a matrix. So they are copied, averaged, stepped
and stored without knowing what is in them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.learners.deep.initialisers import Shape
from apel.learners.deep.networks import Architecture
from apel.learners.deep.products import LANES, aligned

_MAX_PARAMETERS = 10_000_000
"""Six times those of the network for Atari (Mnih et al. 2015)."""


_IMAGES = 5
"""Axes of the weights of convolutions of several runs."""


class Layout:
    """Where the variables of a network lie in a row of parameters.

    The outputs of layers are filled up to whole vectors, with weights that are zero and stay so; and every variable
    begins at a multiple of 64 bytes. A convolution's filters ``[filters, channels, height, width]`` are its outputs,
    and so come last where they are stored, as ``[width, channels, height, filters]``.

    Attributes
    ----------
    begin:
        Where each variable begins.
    size:
        The length of a row.

    Raises
    ------
    ValueError
        If there are so many that the memory of a machine is soon full: each run has some copies of all of them.
    """

    def __init__(self, architecture: Architecture) -> None:
        self._architecture = architecture
        self._stored, self.begin, self.size = list[tuple[int, ...]](), list[int](), 0
        for layer in architecture.layers:
            for shape, _ in layer.variables:
                turned = _turned(shape)
                stored = (*turned[:-1], _filled(turned[-1]))
                self._stored.append(stored)
                self.begin.append(self.size)
                self.size += _filled(math.prod(stored))
        count = sum(math.prod(shape) for layer in architecture.layers for shape, _ in layer.variables)
        if count > _MAX_PARAMETERS:
            message = f"network: found {count:,} parameters, expected at most {_MAX_PARAMETERS:,}"
            raise ValueError(message)

    def initial_rows(self, seeds: Sequence[int]) -> NDArray[np.float32]:
        """``float32[R, P]``: fresh parameters of each run, from its 64-bit seed alone."""
        rows = aligned(len(seeds), self.size)
        for row, seed in zip(rows, seeds, strict=True):
            generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
            initial = [(shape, one) for layer in self._architecture.layers for shape, one in layer.variables]
            for (shape, initialise), variable in zip(initial, self.unpack(row[None]), strict=True):
                variable[0] = initialise(shape, generator)
        return rows

    def unpack(self, rows: Any) -> list[Any]:
        """``[A, …]``: each variable of A rows, NumPy's or PyTorch's, as views without what they are filled up with."""
        parts, shapes = (
            zip(self.begin, self._stored, strict=True),
            [shape for layer in self._architecture.layers for shape, _ in layer.variables],
        )
        views = [rows[:, at : at + math.prod(stored)].reshape(len(rows), *stored) for at, stored in parts]
        whole = [view[..., : _turned(shape)[-1]] for view, shape in zip(views, shapes, strict=True)]
        return [view.swapaxes(1, 4) if view.ndim == _IMAGES else view for view in whole]


def _turned(shape: Shape) -> tuple[int, ...]:
    """The shape of a variable as it is stored, but for what it is filled up with."""
    if len(shape) < _IMAGES - 1:
        return tuple(shape)
    filters, channels, height, width = shape
    return width, channels, height, filters


def _filled(count: int) -> int:
    return -(-count // LANES) * LANES
