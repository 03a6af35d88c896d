"""Networks of all runs of a shard on PyTorch: those on a GPU."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from apel.dynamics.batched_environment import Runs
from apel.learners.base import State
from apel.learners.deep.compiled_network import ACTING, ONLINE, Descent
from apel.learners.deep.devices import open_device
from apel.learners.deep.networks import INPUT, Architecture, Convolution, Dense
from apel.learners.deep.normalising import EPSILON
from apel.learners.deep.parameters import Layout

if find_spec("torch") is None:
    message = 'GPUs need PyTorch: pip install "apel[deep]"'
    raise ImportError(message)

import torch
from torch import Tensor
from torch.nn.functional import layer_norm

from apel.learners.deep.stacked_rows import FrozenRows, RowAdam, Rows, clip_each_row, clip_each_variable

_ACTIVATIONS = {"linear": lambda x: x, "tanh": torch.tanh, "relu": torch.relu}


class StackedNetwork:
    """The networks of R runs, whose parameters are rows of one tensor: one call computes a layer of several runs.

    Parameters
    ----------
    architecture, seeds, descent, has_other:
        See `apel.learners.deep.compiled_network.CompiledNetwork`.
    device, lanes:
        See `apel.learners.deep.dqn.DqnOptions`.
    """

    def __init__(
        self,
        architecture: Architecture,
        seeds: Sequence[int],
        descent: Descent,
        device: str,
        lanes: int,
        *,
        has_other: bool,
    ) -> None:
        opened = open_device(device)
        self.architecture, self.layout, self._descent = architecture, Layout(architecture), descent
        self._rows = Rows(len(seeds), opened, lanes)
        self._online = torch.from_numpy(self.layout.initial_rows(seeds)).to(opened).clone()
        self._other = self._online.clone() if has_other else None
        self._frozen = FrozenRows(self._rows, len(seeds))
        self._adam = RowAdam(self._online, descent.learning_rate, descent.epsilon)
        self._moving = list[Tensor]()
        self._predicted: Tensor | None = None

    @property
    def arrays(self) -> StackedNetwork:
        """What a learner calls."""
        return self

    def calls(self, runs: Runs) -> list[Runs]:
        """The runs of each call."""
        return self._rows.calls(runs)

    def evaluate(self, which: int, runs: Runs, count: int, inputs: Any, outputs: Any) -> None:
        """See `apel.learners.deep.engines`; more runs than lanes come in several calls."""
        self._evaluate({which: outputs}, runs, count, inputs)

    def evaluate_both(
        self, one: int, other: int, runs: Runs, count: int, inputs: Any, outputs: Any, other_outputs: Any
    ) -> None:
        """See `apel.learners.deep.engines`."""
        self._evaluate({one: outputs, other: other_outputs}, runs, count, inputs)
        if one == other:
            outputs[: len(runs), :count] = other_outputs[: len(runs), :count]

    def _evaluate(self, wanted: dict[int, Any], runs: Runs, count: int, inputs: Any) -> None:
        start = 0
        with torch.no_grad():
            for one_call in self.calls(runs):
                chosen = slice(start, start + len(one_call))
                given = self._rows.tensor(inputs[chosen, :count])
                for which, outputs in wanted.items():
                    found = self.values(self._chosen(which, one_call), given)
                    outputs[chosen, :count] = found[: len(one_call)].cpu().numpy()
                start += len(one_call)

    def predict(self, runs: Runs, count: int, inputs: Any, outputs: Any) -> None:
        """See `apel.learners.deep.engines`; of the runs of one call."""
        # Of each variable by itself: through views of a whole row each gradient would be as long as the row.
        variables = self.layout.unpack(self._rows.of(self._online, runs))
        self._moving = [variable.detach().requires_grad_() for variable in variables]
        self._predicted = self._values(self._moving, self._rows.tensor(inputs[: len(runs), :count]))
        outputs[: len(runs), :count] = self._predicted[: len(runs)].detach().cpu().numpy()

    def descend(self, runs: Runs, count: int, inputs: Any, gradient: Any) -> None:
        """See `apel.learners.deep.engines`; of the runs of one call."""
        assert self._predicted is not None  # noqa: S101 - `predict` comes before it
        slope = self._rows.tensor(np.ascontiguousarray(gradient[: len(runs), :count]))
        found = torch.autograd.grad(self._predicted, self._moving, slope)
        gradients = torch.zeros(len(slope), self.layout.size, device=slope.device)
        for place, one in zip(self.layout.unpack(gradients), found, strict=True):
            place.copy_(one)
        self._moving, self._predicted = [], None
        if self._descent.largest_norm > 0.0:
            if self._descent.by_variable:
                clip_each_variable(gradients, self.layout, self._descent.largest_norm)
            else:
                clip_each_row(gradients, self._descent.largest_norm)
        self._adam.step(runs, gradients)

    def follow(self, runs: Runs, share: float) -> None:
        """See `apel.learners.deep.engines`."""
        assert self._other is not None  # noqa: S101 - only those who have another network ask for it
        if share == 1.0:
            self._rows.copy(self._other, self._online, runs)
            return
        for one_call in self.calls(runs):
            moved = self._rows.of(self._other, one_call).lerp(self._rows.of(self._online, one_call), share)
            self._rows.write(self._other, one_call, moved)

    def freeze(self, runs: Runs) -> None:
        """What acts is the networks of today until the next call."""
        self._frozen.freeze(self._online, runs)

    def state(self) -> State:
        """Parameters and moments, by run."""
        return {
            "online": self._rows.array(self._online),
            "other": self._rows.array(self._other),
            "frozen": self._frozen.state(),
            "adam": self._adam.state(),
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._rows.restore(self._online, state["online"])
        if self._other is not None:
            self._rows.restore(self._other, state["other"])
        self._frozen.restore(state["frozen"])
        self._adam.restore(state["adam"])

    def values(self, rows: Tensor, inputs: Tensor) -> Tensor:
        """``[A, B, outputs]`` of parameters ``[A, P]`` and inputs ``[A, B, inputs]``."""
        return self._values(self.layout.unpack(rows), inputs)

    def _values(self, unpacked: Sequence[Tensor], inputs: Tensor) -> Tensor:
        architecture, variables = self.architecture, iter(unpacked)
        given = inputs.reshape(*inputs.shape[:2], *architecture.shape)
        given = given.movedim(-1, 2) if architecture.channels_last else given
        found, heads = list[Tensor](), list[Tensor]()
        for layer in architecture.layers:
            x = given if layer.source == INPUT else found[layer.source]
            weight, bias = next(variables), next(variables)
            if isinstance(layer, Dense):
                made = torch.baddbmm(bias.unsqueeze(1), x.flatten(2), weight)
                made = layer_norm(made, made.shape[-1:], eps=EPSILON) if layer.normalised else made
                found.append(_ACTIVATIONS[layer.activation](made))
                heads += found[-1:] if layer.column is not None else []
            else:
                found.append(torch.relu(_convolve(layer, x, weight, bias)))
        if architecture.dueling:
            advantage, value = heads
            return value + advantage - advantage.mean(-1, keepdim=True)
        return torch.cat(heads, -1)

    def _chosen(self, which: int, runs: Runs) -> Tensor:
        if which == ACTING:
            return self._frozen.of(self._online, runs)
        matrix = self._online if which == ONLINE or self._other is None else self._other
        return self._rows.of(matrix, runs)


def _convolve(layer: Convolution, x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """``[A, B, channels, height, width]`` to the same with other channels: a product of all runs' patches and filters.

    It takes the library of products alone, whose results are reproducible (see `open_device`); those of cuDNN's
    convolutions are not all, and many groups of few channels are slow with them.
    """
    x = torch.nn.functional.pad(x, (*layer.margins(x.shape[-1]), *layer.margins(x.shape[-2])))
    runs, batch = x.shape[:2]
    patches = x.unfold(3, layer.kernel, layer.stride).unfold(4, layer.kernel, layer.stride)
    height, width = patches.shape[3:5]
    columns = patches.permute(0, 1, 3, 4, 2, 5, 6).reshape(runs, batch * height * width, -1)
    found = torch.baddbmm(bias.unsqueeze(1), columns, weight.flatten(2).transpose(1, 2))
    return found.view(runs, batch, height, width, layer.filters).permute(0, 1, 4, 2, 3)
