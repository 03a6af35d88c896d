"""Parameters and optimisers of many runs' networks as rows of PyTorch's tensors."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.optim.adam import adam

from apel.dynamics.batched_environment import Runs
from apel.learners.base import State
from apel.learners.deep.parameters import Layout


class Rows:
    """Chosen rows of matrices with one row per run.

    A library may choose its algorithm, and so its rounding, by the number of rows. So all calls have one shape, of so
    many lanes: more runs come in several calls, and fewer are filled up with copies of the first.
    """

    def __init__(self, num_runs: int, device: torch.device, lanes: int) -> None:
        self.device = device
        self._num_runs = num_runs
        self._lanes = lanes
        self._last = np.zeros(0, dtype=np.int64), torch.zeros(0, dtype=torch.int64)

    def calls(self, runs: Runs) -> list[Runs]:
        """The runs of each call."""
        return [runs[i : i + self._lanes] for i in range(0, len(runs), self._lanes)]

    def of(self, matrix: Tensor, runs: Runs) -> Tensor:
        """``[A or lanes, P]``: the chosen rows; the matrix itself where all are chosen."""
        if len(runs) == self._num_runs == self._lanes:
            return matrix
        return matrix[self._filled(self._chosen(runs))]

    def tensor(self, array: NDArray[Any]) -> Tensor:
        """An array with a row for each chosen run, in the same order, on the device."""
        return self._filled(torch.from_numpy(array).to(self.device))

    def write(self, matrix: Tensor, runs: Runs, values: Tensor) -> None:
        """Set the chosen rows to ``values`` ``[A or lanes, P]``."""
        matrix[self._chosen(runs)] = values[: len(runs)]

    def copy(self, matrix: Tensor, other: Tensor, runs: Runs) -> None:
        """Set the chosen rows to those of another matrix."""
        chosen = self._chosen(runs)
        matrix[chosen] = other[chosen]

    def _chosen(self, runs: Runs) -> Tensor:
        """Their numbers on the device; kept until others are asked for, since all calls of an update name the same."""
        known, chosen = self._last
        if len(known) != len(runs) or not np.array_equal(known, runs):
            # A copy, because on the CPU the tensor would be a view.
            known = runs.copy()
            chosen = torch.from_numpy(known).to(self.device)
            self._last = known, chosen
        return chosen

    def _filled(self, rows: Tensor) -> Tensor:
        """On the device, so that copies need not travel."""
        missing = self._lanes - len(rows)
        return torch.cat([rows, rows[:1].expand(missing, *rows.shape[1:])]) if missing else rows

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
        self._state = {
            "step": torch.zeros(len(rows), dtype=torch.float32, device=rows.device),
            "exp_avg": torch.zeros_like(rows),
            "exp_avg_sq": torch.zeros_like(rows),
        }
        # Views of each run's part, which `torch.optim.Adam` would look up and check one by one in every step.
        self._parameters = rows.unbind()
        self._clocks, self._means, self._squares = (matrix.unbind() for matrix in self._state.values())
        self._learning_rate, self._epsilon = learning_rate, epsilon

    def step(self, runs: Runs, gradients: Tensor) -> None:
        """Descend in the rows of ``runs``, with ``gradients`` ``[A or lanes, P]``."""
        chosen = runs.tolist()
        with torch.no_grad():
            adam(
                [self._parameters[run] for run in chosen],
                list(gradients[: len(chosen)].unbind()),
                [self._means[run] for run in chosen],
                [self._squares[run] for run in chosen],
                [],
                [self._clocks[run] for run in chosen],
                fused=True,
                amsgrad=False,
                beta1=0.9,
                beta2=0.999,
                lr=self._learning_rate,
                weight_decay=0.0,
                eps=self._epsilon,
                maximize=False,
            )

    def state(self) -> State:
        """Clocks and moments."""
        return {name: values.cpu().numpy().copy() for name, values in self._state.items()}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        for name, values in state.items():
            self._state[name].copy_(torch.from_numpy(np.array(values)))
