"""What a network computes, as data: layers with their weights, for programs that know nothing of this one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from apel.learners.deep.deep_learner import BatchedDeepLearner
from apel.learners.deep.networks import INPUT, Architecture, Convolution, Dense, Layer

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class GraphLayer:
    """One layer. A dense one takes what comes in as a vector, a convolution as ``[channels, height, width]``.

    Attributes
    ----------
    weight:
        ``[inputs, outputs]``, or ``[filters, channels, kernel, kernel]``.
    bias:
        ``[outputs]``.
    activation:
        After it.
    stride, pads:
        Of a convolution; what is put above, left, below and right.
    normalised:
        Before its activation, without gain and bias, see `apel.learners.deep.normalising`.
    """

    weight: Floats
    bias: Floats
    activation: Literal["linear", "tanh", "relu"]
    stride: int = 1
    pads: tuple[int, int, int, int] = (0, 0, 0, 0)
    normalised: bool = False


@dataclass(frozen=True)
class NetworkGraph:
    """A network from the inputs of `apel.learners.deep.encoding.Encoder` to a number for each action: the larger, the
    better the action is thought to be.

    Attributes
    ----------
    shape:
        Of an input.
    channels_last:
        Images are turned round first.
    body, head:
        Layers one after the other.
    value:
        With it the outputs are V + A − mean A, A being those of ``head`` (Wang et al. 2016, Eq. 9).
    """

    shape: tuple[int, ...]
    channels_last: bool
    body: tuple[GraphLayer, ...]
    head: tuple[GraphLayer, ...]
    value: tuple[GraphLayer, ...] = ()


def graph_of(learner: Any) -> NetworkGraph | None:
    """The network that a shipped deep learner of one run acts by, as it is now; None of all others."""
    batched = getattr(learner, "_batched", None)
    if not isinstance(batched, BatchedDeepLearner):
        return None
    network, num_actions = batched.acting, batched.num_actions
    row = np.asarray(network.state()["online"])[:1]
    variables = [np.array(variable[0], dtype=np.float32) for variable in network.layout.unpack(row)]
    architecture: Architecture = network.architecture
    chains = [_chain(architecture, i) for i, one in enumerate(architecture.layers) if _is_head(one)]
    # Of an actor-critic the policy's outputs come first, in the same layer.
    made = [[_layer(architecture.layers[i], variables[2 * i : 2 * i + 2], num_actions) for i in one] for one in chains]
    # What both heads share, or all but the last layer.
    split = len(chains[0]) - 1
    if architecture.dueling:
        split = sum(one == other for one, other in zip(*chains, strict=False))
    head, value = made[0][split:], made[1][split:] if architecture.dueling else []
    shape, turned = architecture.shape, architecture.channels_last
    return NetworkGraph(shape, turned, tuple(made[0][:split]), tuple(head), tuple(value))


def _is_head(layer: Layer) -> bool:
    return isinstance(layer, Dense) and layer.column is not None


def _chain(architecture: Architecture, last: int) -> list[int]:
    """The layers that lead to one, from the input on."""
    found, at = list[int](), last
    while at != INPUT:
        found.insert(0, at)
        at = architecture.layers[at].source
    return found


def _layer(layer: Layer, variables: Sequence[Floats], num_actions: int) -> GraphLayer:
    weight, bias = variables
    if isinstance(layer, Convolution):
        (top, bottom), (left, right) = layer.margins(layer.image[1]), layer.margins(layer.image[2])
        return GraphLayer(weight, bias, "relu", layer.stride, (top, left, bottom, right))
    if _is_head(layer):
        weight, bias = weight[:, :num_actions], bias[:num_actions]
    return GraphLayer(weight, bias, layer.activation, normalised=layer.normalised)
