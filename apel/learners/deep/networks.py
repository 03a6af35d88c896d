"""What networks consist of: bodies from options, and the networks of the learners, layer by layer.

Nothing here computes. What is on the processor is computed by compiled loops (`compiled_network`), what is on a GPU by
PyTorch (`stacked_network`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from pydantic.dataclasses import dataclass as options_class

from apel.learners.deep.initialisers import Initialiser, Shape, fan_in_uniform, glorot, orthogonal, side_by_side, zeros
from apel.learners.deep.options import Width
from apel.learners.tabular.q_learning import OPTIONS_CONFIG

Activation = Literal["linear", "tanh", "relu"]
INPUT = -1
_WEIGHTS: dict[str, Initialiser] = {"orthogonal": orthogonal(math.sqrt(2.0)), "glorot": glorot}


@options_class(frozen=True, config=OPTIONS_CONFIG)
class NetworkOptions:
    """The body of a network: convolutions over images, then dense layers.

    Attributes
    ----------
    hidden:
        Units of each dense layer.
    convolutions:
        ``(filters, kernel, stride)`` of each; for observations ``[channels, height, width]`` alone, unless ``layout``
        says otherwise.
    layout:
        Where the channels of an image are: ``channels_first``, or ``channels_last`` for ``[height, width, channels]``,
        which are turned round first. None takes images with the channels first, and refuses those that do not look like
        it: whose last axis is the shortest.
    padding:
        Of the convolutions.
    activation:
        After each dense layer; after convolutions it is always ReLU.
    initialisation:
        Of the weights: orthogonal with gain √2 and zero biases, as in OpenAI Baselines; Glorot's, as it has in its
        network for DQN on Atari; or PyTorch's default.
    layer_norm:
        Each hidden dense layer is normalised before its activation, that of a head too (Ba, Kiros & Hinton 2016;
        without learned gain and bias). With data of others it keeps values from running away (Ball et al. 2023,
        *Efficient Online Reinforcement Learning with Offline Data*).
    """

    hidden: tuple[Width, ...] = (64, 64)
    convolutions: tuple[tuple[Width, Width, Width], ...] = ()
    layout: Literal["channels_first", "channels_last"] | None = None
    padding: Literal["same", "valid"] = "valid"
    activation: Literal["tanh", "relu"] = "tanh"
    initialisation: Literal["orthogonal", "glorot", "pytorch"] = "orthogonal"
    layer_norm: bool = False


@dataclass(frozen=True)
class Dense:
    """``activation(x W + b)`` of the input, or of an earlier layer (`source`), all of it in a row.

    As a head it writes its outputs from `column` on. If it is ``normalised``, then before its activation.
    """

    source: int
    inputs: int
    outputs: int
    activation: Activation
    weight: Initialiser
    bias: Initialiser = zeros
    column: int | None = None
    normalised: bool = False

    @property
    def variables(self) -> list[tuple[Shape, Initialiser]]:
        """Weight and bias."""
        return [((self.inputs, self.outputs), self.weight), ((self.outputs,), self.bias)]


@dataclass(frozen=True)
class Convolution:
    """A convolution with ReLU of an image ``[channels, height, width]``: the input's, or an earlier layer's.

    ``same`` padding is TensorFlow's: as many outputs as inputs divided by the stride, rounded up.
    """

    source: int
    image: tuple[int, int, int]
    filters: int
    kernel: int
    stride: int
    is_padded: bool
    weight: Initialiser

    @property
    def variables(self) -> list[tuple[Shape, Initialiser]]:
        """Weight and bias."""
        return [((self.filters, self.image[0], self.kernel, self.kernel), self.weight), ((self.filters,), zeros)]

    @property
    def result(self) -> tuple[int, int, int]:
        """Channels, height and width after it."""
        return self.filters, self._size(self.image[1]), self._size(self.image[2])

    def _size(self, size: int) -> int:
        return -(-size // self.stride) if self.is_padded else (size - self.kernel) // self.stride + 1

    def margins(self, size: int) -> tuple[int, int]:
        """What is put before and behind a height or width."""
        total = max((self._size(size) - 1) * self.stride + self.kernel - size, 0) if self.is_padded else 0
        return total // 2, total - total // 2


Layer = Dense | Convolution


@dataclass(frozen=True)
class Architecture:
    """A network.

    Attributes
    ----------
    shape:
        Of an input.
    layers:
        In an order in which they can be computed.
    num_outputs:
        Columns of the outputs.
    dueling:
        The last layer is V(s), the head before it A(s, ·), and the outputs are V + A − mean A (Wang et al. 2016, Eq.
        9).
    channels_last:
        Images are turned round first.
    """

    shape: tuple[int, ...]
    layers: tuple[Layer, ...]
    num_outputs: int
    dueling: bool = False
    channels_last: bool = False


def q_network(
    shape: Sequence[int], num_actions: int, options: NetworkOptions, head: Sequence[int] = (), *, dueling: bool = False
) -> Architecture:
    """Q(s, ·) of one body and a head, or, with ``dueling``, two of them.

    Raises
    ------
    ValueError
        If the options do not fit the shape; so of the other networks.
    """
    layers, width = _body([], shape, options)
    body = len(layers) - 1
    _add_head(layers, body, width, head, num_actions, options, 0)
    if dueling:
        _add_head(layers, body, width, head, 1, options, num_actions)
    return _architecture(shape, layers, num_actions, options, dueling=dueling)


def actor_critic(shape: Sequence[int], num_actions: int, options: NetworkOptions) -> Architecture:
    """The logits of a policy, and Q(s, ·): two linear heads of one body, side by side in one layer."""
    layers, width = _body([], shape, options)
    one = _dense(options, len(layers) - 1, width, num_actions, "linear")
    weight, bias = side_by_side(one.weight), side_by_side(one.bias)
    layers.append(Dense(one.source, width, 2 * num_actions, "linear", weight, bias, 0))
    return _architecture(shape, layers, 2 * num_actions, options)


def twin_q(shape: Sequence[int], num_actions: int, options: NetworkOptions) -> Architecture:
    """Two networks Q(s, ·) side by side, of which the smaller value counts (Fujimoto, van Hoof & Meger 2018)."""
    layers: list[Layer] = []
    for column in (0, num_actions):
        layers, width = _body(layers, shape, options)
        source = len(layers) - 1 if options.hidden or options.convolutions else INPUT
        layers.append(_dense(options, source, width, num_actions, "linear", column))
    return _architecture(shape, layers, 2 * num_actions, options)


def _architecture(
    shape: Sequence[int], layers: Sequence[Layer], outputs: int, options: NetworkOptions, *, dueling: bool = False
) -> Architecture:
    turned = bool(options.convolutions) and options.layout == "channels_last"
    return Architecture(tuple(shape), tuple(layers), outputs, dueling, turned)


def _body(layers: list[Layer], shape: Sequence[int], options: NetworkOptions) -> tuple[list[Layer], int]:
    """The layers with those of a body, and how many numbers come out."""
    layers, source = list(layers), INPUT
    if options.convolutions:
        shape = _add_convolutions(layers, shape, options)
        source = len(layers) - 1
    width = math.prod(shape)
    for units in options.hidden:
        layers.append(_dense(options, source, width, units, options.activation))
        width, source = units, len(layers) - 1
    return layers, width


def _dense(
    options: NetworkOptions, source: int, inputs: int, outputs: int, activation: Activation, column: int | None = None
) -> Dense:
    weight = _WEIGHTS.get(options.initialisation, fan_in_uniform(inputs))
    bias: Initialiser = weight if options.initialisation == "pytorch" else zeros
    normalised = options.layer_norm and column is None and activation != "linear"
    return Dense(source, inputs, outputs, activation, weight, bias, column, normalised)


def _add_head(
    layers: list[Layer],
    source: int,
    width: int,
    hidden: Sequence[int],
    outputs: int,
    options: NetworkOptions,
    column: int,
) -> None:
    """ReLU layers and a linear one, initialised as Baselines' heads are."""
    sizes: list[tuple[int, Activation, int | None]] = [(units, "relu", None) for units in hidden]
    for units, activation, place in [*sizes, (outputs, "linear", column)]:
        layer = _dense(options, source, width, units, activation, place)
        if options.initialisation != "pytorch":
            layer = replace(layer, weight=glorot, bias=zeros)
        layers.append(layer)
        source, width = len(layers) - 1, units


def _add_convolutions(layers: list[Layer], shape: Sequence[int], options: NetworkOptions) -> tuple[int, int, int]:
    if len(shape) != 3:
        message = f"convolutions: found observations of shape {tuple(shape)}, expected [channels, height, width]"
        raise ValueError(message)
    if options.layout is None and shape[2] < min(shape[:2]):
        message = (
            f"convolutions: found observations of shape {tuple(shape)}, whose channels seem to come last, expected "
            "[channels, height, width]; with layout: channels_last they are turned round, with layout: channels_first "
            "they are taken as they are"
        )
        raise ValueError(message)
    channels, height, width = shape
    image = (width, channels, height) if options.layout == "channels_last" else (channels, height, width)
    given, source = image, INPUT
    for filters, kernel, stride in options.convolutions:
        weight = _image_weights(options, image[0], kernel)
        layer = Convolution(source, image, filters, kernel, stride, options.padding == "same", weight)
        layers.append(layer)
        image, source = layer.result, len(layers) - 1
        if min(image) < 1:
            message = f"convolutions: found {options.convolutions}, expected kernels that fit into {given}"
            raise ValueError(message)
    return image


def _image_weights(options: NetworkOptions, channels: int, kernel: int) -> Initialiser:
    if options.initialisation == "pytorch":
        return fan_in_uniform(channels * kernel * kernel)
    return _WEIGHTS[options.initialisation]
