"""Network bodies from options, and the networks of the learners, as functions of flat rows of parameters.

The parameters of one run are one row ``float32[P]``, those of R runs a matrix. So they are copied, averaged, stepped
and stored without knowing what is in them. Every variable begins at a multiple of 64 bytes in its row, so that no
run's arithmetic depends on where it stands in the matrix.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Literal

import torch
from pydantic.dataclasses import dataclass
from torch import Tensor

from apel.learners.deep.layers import (
    Chain,
    Convolution,
    Elementwise,
    Initialiser,
    Layer,
    Linear,
    Variable,
    fan_in_uniform,
    glorot,
    orthogonal,
)
from apel.learners.deep.options import Width
from apel.learners.q_learning import OPTIONS_CONFIG

_ALIGNMENT = 16
_ACTIVATIONS = {"tanh": torch.tanh, "relu": torch.relu}
_WEIGHTS: dict[str, Initialiser] = {"orthogonal": orthogonal(math.sqrt(2.0)), "glorot": glorot}


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class NetworkOptions:
    """The body of a network: convolutions over images, then dense layers.

    Attributes
    ----------
    hidden:
        Units of each dense layer.
    convolutions:
        ``(filters, kernel, stride)`` of each; for observations ``[channels, height, width]`` alone.
    padding:
        Of the convolutions.
    activation:
        After each dense layer; after convolutions it is always ReLU.
    initialisation:
        Of the weights: orthogonal with gain √2 and zero biases, as in OpenAI Baselines; Glorot's, as it has in its
        network for DQN on Atari; or PyTorch's default.
    """

    hidden: tuple[Width, ...] = (64, 64)
    convolutions: tuple[tuple[Width, Width, Width], ...] = ()
    padding: Literal["same", "valid"] = "valid"
    activation: Literal["tanh", "relu"] = "tanh"
    initialisation: Literal["orthogonal", "glorot", "pytorch"] = "orthogonal"

    def linear(self, inputs: int, outputs: int) -> Linear:
        """A dense layer, initialised so."""
        if self.initialisation == "pytorch":
            return Linear(inputs, outputs, fan_in_uniform(inputs), fan_in_uniform(inputs))
        return Linear(inputs, outputs, _WEIGHTS[self.initialisation])


def make_body(shape: Sequence[int], options: NetworkOptions) -> tuple[Chain, int]:
    """The body for observations of this shape, and its number of outputs.

    Raises
    ------
    ValueError
        If the options do not fit the shape.
    """
    layers: list[Layer] = []
    if options.convolutions:
        shape = _add_convolutions(layers, shape, options)
    if len(shape) != 1:
        layers.append(Elementwise(lambda x: x.flatten(2)))
    inputs = math.prod(shape)
    for units in options.hidden:
        layers += [options.linear(inputs, units), Elementwise(_ACTIVATIONS[options.activation])]
        inputs = units
    return Chain(layers), inputs


def _add_convolutions(layers: list[Layer], shape: Sequence[int], options: NetworkOptions) -> tuple[int, int, int]:
    if len(shape) != 3:
        message = f"convolutions: found observations of shape {tuple(shape)}, expected [channels, height, width]"
        raise ValueError(message)
    channels, height, width = shape
    for filters, kernel, stride in options.convolutions:
        layer = Convolution(
            channels, filters, kernel, stride, options.padding, _image_weights(options, channels, kernel)
        )
        channels, height, width = filters, layer.output_size(height), layer.output_size(width)
        if min(height, width) < 1:
            message = f"convolutions: found {options.convolutions}, expected kernels that fit into {tuple(shape)}"
            raise ValueError(message)
        layers += [layer, Elementwise(torch.relu)]
    return channels, height, width


def _image_weights(options: NetworkOptions, channels: int, kernel: int) -> Initialiser:
    if options.initialisation == "pytorch":
        return fan_in_uniform(channels * kernel * kernel)
    return _WEIGHTS[options.initialisation]


class Layout:
    """Where the variables of a network lie in a row of parameters.

    Attributes
    ----------
    sizes:
        Elements that each variable takes up, its padding included; their sum is the length of a row.
    """

    def __init__(self, variables: Sequence[Variable]) -> None:
        self._variables = variables
        self._counts = [math.prod(variable.shape) for variable in variables]
        self.sizes = [-(-count // _ALIGNMENT) * _ALIGNMENT for count in self._counts]

    def initial_row(self, generator: torch.Generator) -> Tensor:
        """``float32[P]``: fresh parameters; the padding is zero."""
        row = torch.zeros(1, sum(self.sizes))
        for variable, tensor in zip(self._variables, self.unpack(row), strict=True):
            variable.initialise(tensor[0], generator)
        return row[0]

    def unpack(self, rows: Tensor) -> list[Tensor]:
        """``float32[A, …]``: each variable of A rows, as views."""
        parts = zip(torch.split(rows, self.sizes, 1), self._counts, self._variables, strict=True)
        return [part[:, :count].view(len(rows), *variable.shape) for part, count, variable in parts]


class QNetwork:
    """Q(s, ·) of one body; with ``dueling`` as V(s) + A(s, ·) − mean A(s, ·) (Wang et al. 2016, Eq. 9).

    Attributes
    ----------
    layout:
        Of its parameters.
    """

    def __init__(
        self, shape: Sequence[int], num_actions: int, options: NetworkOptions, head: Sequence[int], *, dueling: bool
    ) -> None:
        self._body, width = make_body(shape, options)
        self._advantage = _head(width, head, num_actions, options)
        self._value = _head(width, head, 1, options) if dueling else None
        value = self._value.variables if self._value else ()
        self.layout = Layout([*self._body.variables, *self._advantage.variables, *value])

    def __call__(self, rows: Tensor, x: Tensor) -> Tensor:
        """``float32[A, B, actions]`` of parameters ``[A, P]`` and observations ``[A, B, …]``."""
        weights: Iterator[Tensor] = iter(self.layout.unpack(rows))
        features = self._body(weights, x)
        advantage = self._advantage(weights, features)
        if self._value is None:
            return advantage
        return self._value(weights, features) + advantage - advantage.mean(-1, keepdim=True)


def _head(inputs: int, hidden: Sequence[int], outputs: int, options: NetworkOptions) -> Chain:
    """ReLU layers and a linear one, initialised as Baselines' heads are."""
    layers: list[Layer] = []
    for units in hidden:
        layers += [_head_linear(inputs, units, options), Elementwise(torch.relu)]
        inputs = units
    return Chain([*layers, _head_linear(inputs, outputs, options)])


def _head_linear(inputs: int, outputs: int, options: NetworkOptions) -> Linear:
    if options.initialisation == "pytorch":
        return options.linear(inputs, outputs)
    return Linear(inputs, outputs, glorot)


class ActorCritic:
    """The logits of a policy and Q(s, ·), two linear heads of one body.

    Attributes
    ----------
    layout:
        Of its parameters.
    """

    def __init__(self, shape: Sequence[int], num_actions: int, options: NetworkOptions) -> None:
        self._body, width = make_body(shape, options)
        self._policy = options.linear(width, num_actions)
        self._values = options.linear(width, num_actions)
        self.layout = Layout([*self._body.variables, *self._policy.variables, *self._values.variables])

    def __call__(self, rows: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
        """Logits and Q, ``float32[A, B, actions]`` each, of parameters ``[A, P]`` and observations ``[A, B, …]``."""
        weights: Iterator[Tensor] = iter(self.layout.unpack(rows))
        features = self._body(weights, x)
        return self._policy(weights, features), self._values(weights, features)


class TwinQ:
    """Two networks Q(s, ·) side by side, of which the smaller value counts (Fujimoto, van Hoof & Meger 2018).

    Attributes
    ----------
    layout:
        Of its parameters.
    """

    def __init__(self, shape: Sequence[int], num_actions: int, options: NetworkOptions) -> None:
        bodies = [make_body(shape, options) for _ in range(2)]
        self._critics = [Chain([body, options.linear(width, num_actions)]) for body, width in bodies]
        self.layout = Layout([variable for critic in self._critics for variable in critic.variables])

    def __call__(self, rows: Tensor, x: Tensor) -> Tensor:
        """``float32[2, A, B, actions]`` of parameters ``[A, P]`` and observations ``[A, B, …]``."""
        weights: Iterator[Tensor] = iter(self.layout.unpack(rows))
        return torch.stack([critic(weights, x) for critic in self._critics])
