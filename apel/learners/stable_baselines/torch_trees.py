"""Trees of PyTorch's tensors as trees of arrays, and back: what a checkpoint can hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from apel.learners.base import State


def arrays_of(tree: Any) -> Any:
    """Tensors as arrays, keys as texts: what a checkpoint can hold."""
    import torch

    match tree:
        case torch.Tensor():
            return tree.detach().cpu().numpy().copy()
        case Mapping():
            return {str(key): arrays_of(child) for key, child in tree.items()}
        case list() | tuple():
            return [arrays_of(child) for child in tree]
    return tree


def tensors_of(tree: Any) -> Any:
    """The tree that `arrays_of` made arrays of."""
    import torch

    match tree:
        case np.ndarray():
            return torch.tensor(tree)
        case dict():
            return {key: tensors_of(child) for key, child in tree.items()}
        case list():
            return [tensors_of(child) for child in tree]
    return tree


def state_dict_of(stored: State) -> Any:
    """The state of a module or of an optimiser; the latter numbers its parameters."""
    tensors = tensors_of(stored)
    if "param_groups" in tensors:
        tensors["state"] = {int(index): one for index, one in tensors["state"].items()}
    return tensors
