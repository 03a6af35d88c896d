"""What learners saw last, seen at once: stacks of the views of several runs (Mnih et al. 2015).

Where stacks of one are asked for, all of this is free and changes nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs


class StackSpace(spaces.Box):
    """Stacks of ``size`` elements of a Box: ``[size, …]``."""

    def __init__(self, space: spaces.Box, size: int) -> None:
        low, high = (np.repeat(bound[None], size, axis=0) for bound in (space.low, space.high))
        super().__init__(low, high, dtype=space.dtype.type)
        self.size = size


def stacked_space(space: spaces.Space[Any], size: int) -> spaces.Space[Any]:
    """The space of stacks of ``size`` elements of ``space``: ``[size, …]``.

    Raises
    ------
    ValueError
        If such elements cannot be stacked.
    """
    if size == 1:
        return space
    if not isinstance(space, spaces.Box):
        message = f"stack: found {size} for {space}, expected a Box wherever more than one is to be stacked"
        raise ValueError(message)
    return StackSpace(space, size)


class ViewStacks:
    """The stacks of R runs.

    Parameters
    ----------
    num_runs, size:
        R, and how many views a stack has.
    space:
        Of the stacks, see `stacked_space`.
    """

    def __init__(self, num_runs: int, size: int, space: spaces.Space[Any]) -> None:
        self._size = size
        if size > 1:
            self._views = np.zeros((num_runs, *(space.shape or ())), dtype=space.dtype)

    def start(self, runs: Runs, seen: NDArray[Any]) -> NDArray[Any]:
        """``[A, size, …]``: stacks at the first views ``[A, …]`` of episodes of ``runs``."""
        if self._size == 1:
            return seen
        self._views[runs] = seen[:, None]
        return self._views[runs]

    def push(self, runs: Runs, seen: NDArray[Any]) -> NDArray[Any]:
        """``[A, size, …]``: stacks after one more view of each of ``runs``."""
        if self._size == 1:
            return seen
        self._views[runs, :-1] = self._views[runs, 1:]
        self._views[runs, -1] = seen
        return self._views[runs]
