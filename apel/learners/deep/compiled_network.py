"""The networks of all runs of a shard, each computed by itself in compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.learners.base import State
from apel.learners.deep.layer_table import INPUTS, MAP, OUTPUTS, Layers, Maps, filled, table_of
from apel.learners.deep.networks import Architecture
from apel.learners.deep.parameters import Layout
from apel.learners.deep.passes import Kernels, call_adam, call_backward, call_clip, call_forward, kernels
from apel.learners.deep.products import LANES, Floats, aligned
from apel.numerics.compiled import njit

ONLINE, OTHER, ACTING = range(3)
"""The network that learns; its target, or average; what the policy acts on."""


class Descent(NamedTuple):
    """How networks learn: Adam's learning rate and ε, and the norm that gradients are clipped to (0: not at all), each
    variable by itself or all together.
    """

    learning_rate: float
    epsilon: float
    largest_norm: float = 0.0
    by_variable: bool = False


class NetworkArrays(NamedTuple):
    """Those of R runs with P parameters each, and room for what a minibatch of one of them takes."""

    layers: Layers
    maps: Maps
    dueling: int
    online: Floats
    """``float32[R, P]``."""
    other: Floats
    frozen: Floats
    is_frozen: NDArray[np.bool_]
    mean: Floats
    """Adam's first moment."""
    square: Floats
    clock: NDArray[np.int64]
    """``int64[R]``: steps of Adam so far."""
    descent: Descent
    activations: Floats
    patches: Floats
    normalised: Floats
    deltas: Floats
    transposed: Floats
    gradient: Floats
    kernels: Kernels

    def evaluate(self, *arguments: Any) -> None:
        """See `apel.learners.deep.engines`."""
        evaluate(self, *arguments)

    def predict(self, *arguments: Any) -> None:
        """See `apel.learners.deep.engines`."""
        predict(self, *arguments)

    def descend(self, *arguments: Any) -> None:
        """See `apel.learners.deep.engines`."""
        descend(self, *arguments)

    def follow(self, *arguments: Any) -> None:
        """See `apel.learners.deep.engines`."""
        follow(self, *arguments)


@njit
def evaluate(network: NetworkArrays, which: int, runs: Runs, count: int, inputs: Any, outputs: Any) -> None:
    """See `apel.learners.deep.engines`."""
    for i in range(runs.shape[0]):
        run = runs[i]
        row = network.online[run]
        if which == OTHER:
            row = network.other[run]
        elif which == ACTING and network.is_frozen[run]:
            row = network.frozen[run]
        call_forward(
            network.kernels.forward,
            (
                network.layers, network.maps, network.dueling, row, inputs[i, :count], network.activations,
                network.patches, network.normalised, outputs[i, :count],
            ),
        )  # fmt: skip


@njit
def predict(network: NetworkArrays, runs: Runs, count: int, inputs: Any, outputs: Any) -> None:
    """See `apel.learners.deep.engines`; of one run."""
    evaluate(network, ONLINE, runs, count, inputs, outputs)


@njit
def descend(network: NetworkArrays, runs: Runs, count: int, inputs: Any, gradient: Any) -> None:
    """See `apel.learners.deep.engines`; of one run."""
    run, descent = runs[0], network.descent
    row, found = network.online[run], network.gradient
    examples = inputs[0, :count], network.activations, network.patches, network.normalised, gradient[0, :count]
    rooms = network.deltas, network.transposed, found
    call_backward(network.kernels.backward, (network.layers, network.maps, network.dueling, row, *examples, *rooms))
    if descent.largest_norm > 0.0:
        call_clip(network.kernels.clip, (network.layers, descent.by_variable, descent.largest_norm, found))
    network.clock[run] += 1
    rates = descent.learning_rate, descent.epsilon
    moments = network.mean[run], network.square[run]
    call_adam(network.kernels.adam, (network.clock[run], *rates, found, row, *moments))


@njit
def follow(network: NetworkArrays, runs: Runs, share: float) -> None:
    """See `apel.learners.deep.engines`."""
    part = np.float32(share)
    for i in range(runs.shape[0]):
        online, other = network.online[runs[i]], network.other[runs[i]]
        if share == 1.0:
            other[:] = online
        else:
            for j in range(online.shape[0]):
                other[j] += part * (online[j] - other[j])


class CompiledNetwork:
    """The networks of R runs.

    Parameters
    ----------
    architecture:
        Their layers.
    seeds:
        A 64-bit seed per run.
    descent:
        How they learn.
    batch_size:
        Examples of the largest minibatch.
    has_other:
        Each has another network beside it, the same at first.
    """

    is_compiled = True

    def __init__(
        self, architecture: Architecture, seeds: Sequence[int], descent: Descent, batch_size: int, *, has_other: bool
    ) -> None:
        layout = Layout(architecture)
        num_runs, table = len(seeds), table_of(architecture, layout)
        layers = table.layers.tolist()
        # Those that a map reads are written to with their weights' rows as columns.
        widest = max(max(filled(one[OUTPUTS]), filled(one[INPUTS]) if one[MAP] >= 0 else 0) for one in layers)
        largest = max(one[OUTPUTS] * filled(one[INPUTS]) for one in layers)
        online = layout.initial_rows(seeds)
        other = aligned(num_runs if has_other else 0, layout.size)
        other[:] = online[: len(other)]
        # Room for transposed weights, then zeros, then a one.
        transposed = aligned(largest + widest + LANES)
        transposed[-LANES] = 1.0
        self.architecture, self.layout = architecture, layout
        self.arrays = NetworkArrays(
            layers=table.layers,
            maps=table.maps,
            dueling=int(architecture.dueling),
            online=online,
            other=other,
            frozen=aligned(0, layout.size),
            is_frozen=np.zeros(num_runs, dtype=np.bool_),
            mean=aligned(num_runs, layout.size),
            square=aligned(num_runs, layout.size),
            clock=np.zeros(num_runs, dtype=np.int64),
            descent=descent,
            activations=aligned(batch_size * table.values),
            patches=aligned(batch_size * table.patches),
            normalised=aligned(batch_size * table.normalised),
            deltas=aligned(batch_size * table.values),
            transposed=transposed,
            gradient=aligned(layout.size),
            kernels=kernels(),
        )

    def freeze(self, runs: Runs) -> None:
        """What acts is the networks of today until the next call."""
        if not len(self.arrays.frozen):
            self.arrays = self.arrays._replace(frozen=aligned(*self.arrays.online.shape))
        self.arrays.frozen[runs] = self.arrays.online[runs]
        self.arrays.is_frozen[runs] = True

    def state(self) -> State:
        """Parameters and moments, by run."""
        arrays = self.arrays
        frozen = {"rows": arrays.frozen.copy() if len(arrays.frozen) else None, "is_frozen": arrays.is_frozen.copy()}
        adam = {"clock": arrays.clock.copy(), "mean": arrays.mean.copy(), "square": arrays.square.copy()}
        other = arrays.other.copy() if len(arrays.other) else None
        return {"online": arrays.online.copy(), "other": other, "frozen": frozen, "adam": adam}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        arrays = self.arrays
        arrays.online[:] = state["online"]
        if state["other"] is not None:
            arrays.other[:] = state["other"]
        frozen, adam = state["frozen"], state["adam"]
        if frozen["rows"] is not None:
            self.arrays = arrays._replace(frozen=aligned(*arrays.online.shape))
            self.arrays.frozen[:] = frozen["rows"]
        arrays.is_frozen[:] = frozen["is_frozen"]
        for name in ("clock", "mean", "square"):
            getattr(arrays, name)[:] = adam[name]
