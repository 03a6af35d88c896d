"""What a layer with a map reads, and gradients on the way back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.learners.deep.layer_table import INPUTS, MAP, PATCHES, PLACES, Maps, filled
from apel.learners.deep.products import Floats
from apel.numerics.compiled import njit


@njit
def _patch(
    count: int, layer: NDArray[np.int64], maps: Maps, patches: Floats, example: int, place: int
) -> tuple[Floats, Maps]:
    """One of an example's patches, and where its numbers lie in the layer's source."""
    depth = layer[INPUTS]
    at = count * layer[PATCHES] + (example * layer[PLACES] + place) * filled(depth)
    begin = layer[MAP] + place * depth
    return patches[at : at + depth], maps[begin : begin + depth]


@njit
def gather(
    count: int, layer: NDArray[np.int64], maps: Maps, source: Any, source_at: int, stride: int, patches: Floats
) -> None:
    """Write the patches of ``count`` examples, whose source begins at ``source_at``, ``stride`` apart."""
    for b in range(count):
        given = source[source_at + b * stride : source_at + (b + 1) * stride]
        for place in range(layer[PLACES]):
            patch, chosen = _patch(count, layer, maps, patches, b, place)
            for j in range(patch.shape[0]):
                patch[j] = given[chosen[j]] if chosen[j] >= 0 else np.float32(0.0)


@njit
def scatter(
    count: int, layer: NDArray[np.int64], maps: Maps, patches: Floats, deltas: Floats, source_at: int, stride: int
) -> None:
    """Add the gradients in ``patches`` to those of what was gathered there, place by place."""
    for b in range(count):
        given = deltas[source_at + b * stride : source_at + (b + 1) * stride]
        for place in range(layer[PLACES]):
            patch, chosen = _patch(count, layer, maps, patches, b, place)
            for j in range(patch.shape[0]):
                if chosen[j] >= 0:
                    given[chosen[j]] += patch[j]
