"""What a layer with a map reads, and gradients on the way back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.learners.deep.layer_table import INPUTS, MAP, PATCHES, PLACES, Maps, filled
from apel.learners.deep.products import Floats
from apel.numerics.compiled import njit


@njit
def gather(
    count: int, layer: NDArray[np.int64], maps: Maps, source: Any, source_at: int, stride: int, patches: Floats
) -> None:
    """Write the patches of ``count`` examples, whose source begins at ``source_at``, ``stride`` apart."""
    places, depth, width = layer[PLACES], layer[INPUTS], filled(layer[INPUTS])
    for b in range(count):
        given = source[source_at + b * stride : source_at + (b + 1) * stride]
        for place in range(places):
            at, begin = count * layer[PATCHES] + (b * places + place) * width, layer[MAP] + place * depth
            patch, chosen = patches[at : at + depth], maps[begin : begin + depth]
            for j in range(depth):
                patch[j] = given[chosen[j]] if chosen[j] >= 0 else np.float32(0.0)


@njit
def scatter(
    count: int, layer: NDArray[np.int64], maps: Maps, patches: Floats, deltas: Floats, source_at: int, stride: int
) -> None:
    """Add the gradients in ``patches`` to those of what was gathered there, place by place."""
    places, depth, width = layer[PLACES], layer[INPUTS], filled(layer[INPUTS])
    for b in range(count):
        given = deltas[source_at + b * stride : source_at + (b + 1) * stride]
        for place in range(places):
            at, begin = count * layer[PATCHES] + (b * places + place) * width, layer[MAP] + place * depth
            patch, chosen = patches[at : at + depth], maps[begin : begin + depth]
            for j in range(depth):
                if chosen[j] >= 0:
                    given[chosen[j]] += patch[j]
