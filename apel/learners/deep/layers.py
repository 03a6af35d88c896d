"""The layers of networks whose weights are rows of stacked tensors: one call computes them for many runs.

All inputs are ``float32[A, B, …]`` and all weights ``float32[A, …]`` for A runs with a batch of B each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import torch
from torch import Tensor

Initialiser = Callable[[Tensor, torch.Generator], object]
"""Fills one weight, in PyTorch's shape ``[outputs, inputs, …]``."""


@dataclass(frozen=True)
class Variable:
    """One weight or bias of one run."""

    shape: tuple[int, ...]
    initialise: Initialiser


def orthogonal(gain: float) -> Initialiser:
    """Saxe et al. 2014, as OpenAI Baselines initialises its bodies."""
    return lambda weight, generator: torch.nn.init.orthogonal_(weight, gain, generator)


def glorot(weight: Tensor, generator: torch.Generator) -> None:
    """Glorot & Bengio 2010, the uniform form: TensorFlow's default, and so that of Baselines' heads."""
    torch.nn.init.xavier_uniform_(weight, generator=generator)


def fan_in_uniform(fan_in: int) -> Initialiser:
    """PyTorch's default: uniform on ±1 / √``fan_in``, for weights and biases."""
    bound = fan_in**-0.5
    return lambda weight, generator: torch.nn.init.uniform_(weight, -bound, bound, generator)


def zeros(weight: Tensor, generator: torch.Generator) -> None:
    """For biases."""
    weight.zero_()


class Layer(Protocol):
    """A function of some variables."""

    @property
    def variables(self) -> Sequence[Variable]:
        """Its variables, in the order in which it takes them."""
        ...

    def __call__(self, weights: Iterator[Tensor], x: Tensor) -> Tensor:
        """Apply it, taking its variables from ``weights``."""
        ...


class Linear:
    """``x W + b``: ``[A, B, inputs]`` to ``[A, B, outputs]``."""

    def __init__(self, inputs: int, outputs: int, weight: Initialiser, bias: Initialiser = zeros) -> None:
        self.variables = (
            Variable((inputs, outputs), lambda tensor, generator: weight(tensor.t(), generator)),
            Variable((outputs,), bias),
        )

    def __call__(self, weights: Iterator[Tensor], x: Tensor) -> Tensor:
        """See `Layer`."""
        weight, bias = next(weights), next(weights)
        if weight.shape[-1] == 1:
            # A batched matrix product with one column rounds differently from one number of runs to another, and a
            # run's result must not depend on its neighbours.
            return (x * weight.transpose(1, 2)).sum(-1, keepdim=True) + bias.unsqueeze(1)
        if x.shape[:2] == (1, 1):
            # A single product of a vector is none of a batch, and on some machines rounds differently.
            x, weight, bias = (tensor.expand(2, *tensor.shape[1:]) for tensor in (x, weight, bias))
            return torch.baddbmm(bias.unsqueeze(1), x, weight)[:1]
        return torch.baddbmm(bias.unsqueeze(1), x, weight)


class Convolution:
    """``[A, B, channels, height, width]`` to the same with ``filters`` channels.

    ``same`` padding is TensorFlow's: as many outputs as inputs divided by the stride, rounded up.
    """

    def __init__(
        self,
        channels: int,
        filters: int,
        kernel: int,
        stride: int,
        padding: Literal["same", "valid"],
        weight: Initialiser,
    ) -> None:
        self.variables = (Variable((filters, channels, kernel, kernel), weight), Variable((filters,), zeros))
        self._kernel, self._stride, self._is_padded = kernel, stride, padding == "same"

    def __call__(self, weights: Iterator[Tensor], x: Tensor) -> Tensor:
        """See `Layer`."""
        weight, bias = next(weights), next(weights)
        if self._is_padded:
            x = torch.nn.functional.pad(x, (*self._margins(x.shape[-1]), *self._margins(x.shape[-2])))
        # Run by run: a batch of images keeps a core busy, and a grouped convolution's rounding depends on the groups.
        each = zip(x, weight, bias, strict=True)
        return torch.stack([torch.nn.functional.conv2d(one, w, b, stride=self._stride) for one, w, b in each])

    def output_size(self, size: int) -> int:
        """Height (or width) after it."""
        if self._is_padded:
            return -(-size // self._stride)
        return (size - self._kernel) // self._stride + 1

    def _margins(self, size: int) -> tuple[int, int]:
        total = max((self.output_size(size) - 1) * self._stride + self._kernel - size, 0)
        return total // 2, total - total // 2


class Elementwise:
    """A function without variables, such as an activation."""

    variables = ()

    def __init__(self, function: Callable[[Tensor], Tensor]) -> None:
        self._function = function

    def __call__(self, weights: Iterator[Tensor], x: Tensor) -> Tensor:
        """See `Layer`."""
        return self._function(x)


class Chain:
    """Layers one after the other."""

    def __init__(self, layers: Sequence[Layer]) -> None:
        self._layers = layers
        self.variables = [variable for layer in layers for variable in layer.variables]

    def __call__(self, weights: Iterator[Tensor], x: Tensor) -> Tensor:
        """See `Layer`."""
        for layer in self._layers:
            x = layer(weights, x)
        return x
