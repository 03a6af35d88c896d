"""Layers as numbers that compiled code reads: a row of a table for each, and for some a map.

A layer that reads its source as it lies there needs no map. A convolution does: its input is one row for each place of
its filter, the *patch* that the filter lies on there, and so a convolution is a dense layer over patches. So does a
dense layer behind a convolution, since features lie place by place and filter by filter, and are told apart filter by
filter (PyTorch's order, in which weights are stored).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.learners.deep.networks import INPUT, Architecture, Convolution, Dense, Layer
from apel.learners.deep.parameters import Layout
from apel.learners.deep.products import LANES
from apel.numerics.compiled import njit

SOURCE, INPUTS, OUTPUTS, WEIGHT, BIAS, ACTIVATION, COLUMN, PLACES, ROOM, MAP, PATCHES, NORMAL = range(12)
"""What stands in the row of a layer: the layer that it reads (−1: the input); how many numbers go in at each place, and
come out; where its weights ``[inputs, filled outputs]`` and its biases begin; its activation; its first column among
the outputs (−1: it is no head); how many places there are (1: it is dense); how many numbers of each example the layers
before it take up; where its map begins (−1: it has none), how many numbers of each example the patches before its own
take up; and the same of normalised values (−1: it does not normalise)."""
LINEAR, TANH, RELU = range(3)
NOTHING = -1
"""In a map: what lies beyond the image, a zero."""
_ACTIVATIONS = {"linear": LINEAR, "tanh": TANH, "relu": RELU}

Layers = NDArray[np.int64]
"""``int64[layers, 12]``."""
Maps = NDArray[np.int32]
"""``int32[…]``: for every number of every patch of an example, place by place, where it lies in the layer's source."""


@njit(inline="always")
def filled(count: int) -> int:
    """``count``, filled up to whole vectors."""
    return (count + LANES - 1) // LANES * LANES


class Table(NamedTuple):
    """All layers, their maps, and how many numbers an example takes up in each of the rooms."""

    layers: Layers
    maps: Maps
    values: int
    patches: int
    normalised: int


def table_of(architecture: Architecture, layout: Layout) -> Table:
    """Of a network."""
    rows, maps, used = list[list[int]](), list[NDArray[np.int32]](), [0, 0, 0]
    for i, layer in enumerate(architecture.layers):
        found = _map_of(architecture, layer)
        inputs, outputs, places = _sizes(layer)
        is_normalised = isinstance(layer, Dense) and layer.normalised
        activation, column = "relu", -1
        if isinstance(layer, Dense):
            activation, column = layer.activation, -1 if layer.column is None else layer.column
        source = -1 if layer.source == INPUT else layer.source
        begin = layout.begin[2 * i], layout.begin[2 * i + 1]
        at = -1 if found is None else sum(len(one) for one in maps)
        normal = used[2] if is_normalised else -1
        rows.append(
            [source, inputs, outputs, *begin, _ACTIVATIONS[activation], column, places, used[0], at, used[1], normal]
        )
        used[0] += places * filled(outputs)
        if found is not None:
            maps.append(found)
            used[1] += places * filled(inputs)
        if is_normalised:
            used[2] += filled(outputs) + LANES
    joined = np.concatenate(maps) if maps else np.zeros(0, dtype=np.int32)
    return Table(np.array(rows, dtype=np.int64), joined, *used)


def _sizes(layer: Layer) -> tuple[int, int, int]:
    """Numbers in and out at each place, and places."""
    if isinstance(layer, Dense):
        return layer.inputs, layer.outputs, 1
    _, height, width = layer.result
    return layer.image[0] * layer.kernel**2, layer.filters, height * width


def _map_of(architecture: Architecture, layer: Layer) -> NDArray[np.int32] | None:
    """Where a layer's inputs lie in its source; None if they lie there in their order."""
    before = None if layer.source == INPUT else architecture.layers[layer.source]
    if isinstance(layer, Dense):
        if not isinstance(before, Convolution):
            return None
        return _places_of(before).ravel().astype(np.int32)
    if before is None:
        image = np.arange(np.prod(layer.image)).reshape(architecture.shape)
        image = np.moveaxis(image, -1, 0) if architecture.channels_last else image
    else:
        assert isinstance(before, Convolution)  # noqa: S101 - convolutions stand before all dense layers
        image = _places_of(before)
    margins = layer.margins(image.shape[1]), layer.margins(image.shape[2])
    image = np.pad(image, ((0, 0), *margins), constant_values=NOTHING)
    windows = np.lib.stride_tricks.sliding_window_view(image, (layer.kernel, layer.kernel), axis=(1, 2))
    windows = windows[:, :: layer.stride, :: layer.stride]  # [channels, rows, columns, y, x]
    # As weights are stored, see `Layout`: x, channel, y.
    return np.ascontiguousarray(windows.transpose(1, 2, 4, 0, 3)).ravel().astype(np.int32)


def _places_of(layer: Convolution) -> NDArray[np.int64]:
    """``[channels, height, width]``: where the outputs of a convolution lie."""
    channels, height, width = layer.result
    places = np.arange(height * width).reshape(height, width) * filled(channels)
    return np.arange(channels)[:, None, None] + places
