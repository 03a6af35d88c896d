"""Parameters and optimisers of many runs' networks as rows of PyTorch's tensors."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from apel.dynamics.batched_environment import Runs
from apel.learners.base import State
from apel.learners.deep.parameters import Layout


class Rows:
    """Chosen rows of matrices with one row per run.

    On the CPU what a run's row gives does not depend on the other rows that are chosen (tests hold that, bit for bit).
    Elsewhere a library may choose its algorithm by the number of rows; there all calls have one shape, of so many
    lanes: more runs come in several calls, and fewer are filled up with copies of the first.
    """

    def __init__(self, num_runs: int, device: torch.device, lanes: int) -> None:
        self.device = device
        self._num_runs = num_runs
        self._lanes = None if device.type == "cpu" else lanes

    def calls(self, runs: Runs) -> list[Runs]:
        """The runs of each call."""
        if self._lanes is None:
            return [runs] if len(runs) else []
        return [runs[i : i + self._lanes] for i in range(0, len(runs), self._lanes)]

    def of(self, matrix: Tensor, runs: Runs) -> Tensor:
        """``[A or lanes, P]``: the chosen rows; the matrix itself where all are chosen."""
        chosen = self._filled(runs)
        if len(runs) == len(chosen) == self._num_runs:
            return matrix
        return matrix[torch.from_numpy(chosen).to(self.device)]

    def tensor(self, array: NDArray[Any]) -> Tensor:
        """An array with a row for each chosen run, in the same order, on the device."""
        return torch.from_numpy(self._filled(array)).to(self.device)

    def write(self, matrix: Tensor, runs: Runs, values: Tensor) -> None:
        """Set the chosen rows to ``values`` ``[A or lanes, P]``."""
        matrix[torch.from_numpy(runs).to(self.device)] = values[: len(runs)]

    def copy(self, matrix: Tensor, other: Tensor, runs: Runs) -> None:
        """Set the chosen rows to those of another matrix."""
        chosen = torch.from_numpy(runs).to(self.device)
        matrix[chosen] = other[chosen]

    def _filled(self, array: NDArray[Any]) -> NDArray[Any]:
        missing = 0 if self._lanes is None else self._lanes - len(array)
        return np.concatenate([array, np.repeat(array[:1], missing, axis=0)]) if missing else array

    def array(self, matrix: Tensor | None) -> NDArray[np.float32] | None:
        """A matrix as a checkpoint holds it."""
        return None if matrix is None else matrix.cpu().numpy().copy()

    def matrix(self, array: NDArray[np.float32] | None) -> Tensor | None:
        """The matrix that `array` stored."""
        return None if array is None else torch.from_numpy(np.array(array)).to(self.device)

    def restore(self, matrix: Tensor, array: NDArray[np.float32]) -> None:
        """Write what `array` stored into a matrix that others hold views of."""
        matrix.copy_(torch.from_numpy(np.array(array)))


class FrozenRows:
    """The rows that runs act on: their own, or what those were when the run was frozen last."""

    def __init__(self, rows: Rows, num_runs: int) -> None:
        self._rows = rows
        self._matrix: Tensor | None = None
        self._is_frozen = np.zeros(num_runs, dtype=np.bool_)

    def freeze(self, online: Tensor, runs: Runs) -> None:
        """Keep the chosen rows of ``online`` ``[R, P]`` as they are now."""
        if self._matrix is None:
            self._matrix = torch.zeros_like(online)
        self._rows.copy(self._matrix, online, runs)
        self._is_frozen[runs] = True

    def of(self, online: Tensor, runs: Runs) -> Tensor:
        """``[A or lanes, P]``: what the chosen runs act on."""
        own = self._rows.of(online, runs)
        if self._matrix is None:
            return own
        is_frozen = self._rows.tensor(self._is_frozen[runs]).unsqueeze(1)
        return torch.where(is_frozen, self._rows.of(self._matrix, runs), own)

    def state(self) -> State:
        """The rows that are frozen."""
        return {"rows": self._rows.array(self._matrix), "is_frozen": self._is_frozen.copy()}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._matrix = self._rows.matrix(state["rows"])
        self._is_frozen = np.array(state["is_frozen"])


def clip_each_variable(gradients: Tensor, layout: Layout, max_norm: float) -> Tensor:
    """Scale the gradient of each variable of each row to a norm of at most ``max_norm`` (TensorFlow's
    ``clip_by_norm``, as OpenAI Baselines uses it); ``gradients`` ``[A, P]`` is changed in place.
    """
    for begin, end in zip(layout.begin, [*layout.begin[1:], layout.size], strict=True):
        clip_each_row(gradients[:, begin:end], max_norm)
    return gradients


def clip_each_row(gradients: Tensor, max_norm: float) -> Tensor:
    """Scale each row ``[A, P]``, all variables of a run together, to a norm of at most ``max_norm``, in place."""
    norms = torch.linalg.vector_norm(gradients, dim=1, keepdim=True)
    return gradients.mul_(max_norm / norms.clamp(min=max_norm))


class RowAdam:
    """Adam (Kingma & Ba 2015) with a clock and moments of its own for every row of ``rows`` ``[R, P]``."""

    def __init__(self, rows: Tensor, learning_rate: float, epsilon: float) -> None:
        self._parameters = [torch.nn.Parameter(row) for row in rows]
        self._adam = torch.optim.Adam(self._parameters, lr=learning_rate, eps=epsilon, fused=True)

    def step(self, runs: Runs, gradients: Tensor) -> None:
        """Descend in the rows of ``runs``, with ``gradients`` ``[A or lanes, P]``."""
        chosen = [self._parameters[run] for run in runs.tolist()]
        for parameter, gradient in zip(chosen, gradients, strict=False):
            parameter.grad = gradient
        self._adam.step()
        for parameter in chosen:
            parameter.grad = None

    def state(self) -> State:
        """Clocks and moments."""
        states = [self._adam.state[parameter] or _no_moments(parameter) for parameter in self._parameters]
        return {name: torch.stack([one[name] for one in states]).cpu().numpy() for name in _no_moments(torch.zeros(1))}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        for i, parameter in enumerate(self._parameters):
            stored = {name: torch.from_numpy(np.array(values[i])) for name, values in state.items()}
            self._adam.state[parameter] = {name: value.to(parameter.device) for name, value in stored.items()}


def _no_moments(parameter: Tensor) -> dict[str, Tensor]:
    return {
        "step": torch.zeros((), dtype=torch.float32),
        "exp_avg": torch.zeros_like(parameter),
        "exp_avg_sq": torch.zeros_like(parameter),
    }
