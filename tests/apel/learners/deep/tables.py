"""Networks without a body over one-hot states: their heads are tables, so that every number can be worked by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from apel.learners.deep.compiled_network import CompiledNetwork, Descent
from apel.learners.deep.networks import Architecture
from apel.learners.deep.parameters import Layout
from apel.learners.deep.stacked_network import StackedNetwork

Values = NDArray[np.float32]


def rows_of(architecture: Architecture, *runs: list[Any]) -> Values:
    """``float32[R, P]`` with these variables, for each run as many as there are."""
    layout = Layout(architecture)
    rows = np.zeros((len(runs), layout.size), dtype=np.float32)
    for run, values in enumerate(runs):
        for variable, value in zip(layout.unpack(rows), values, strict=True):
            variable[run] = np.asarray(value, dtype=np.float32)
    return rows


def compiled(architecture: Architecture, rows: Values, x: Values) -> Values:
    """``[A, B, outputs]`` of the compiled engine, with these parameters and inputs ``[A, B, …]``."""
    network = CompiledNetwork(architecture, range(len(rows)), Descent(1e-3, 1e-8), x.shape[1], has_other=False)
    network.arrays.online[:] = rows
    outputs = np.zeros((*x.shape[:2], architecture.num_outputs), dtype=np.float32)
    flat = np.ascontiguousarray(x.reshape(*x.shape[:2], -1), dtype=np.float32)
    network.arrays.evaluate(0, np.arange(len(rows)), x.shape[1], flat, outputs)
    return outputs


def stacked(architecture: Architecture, rows: Values, x: Values) -> Values:
    """The same of PyTorch."""
    network = StackedNetwork(architecture, range(len(rows)), Descent(1e-3, 1e-8), "cpu", 8, has_other=False)
    flat = np.ascontiguousarray(x.reshape(*x.shape[:2], -1), dtype=np.float32)
    with torch.no_grad():
        return np.asarray(network.values(torch.from_numpy(rows), torch.from_numpy(flat)).numpy())
