"""Runs, and what their learners see, row by row."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs

Seers = tuple[Runs, NDArray[Any]]
"""Runs, in rising order, and what their learners see."""


def replaced(seen: NDArray[Any], positions: NDArray[np.int64], other: NDArray[Any]) -> NDArray[Any]:
    """A copy with other rows at some positions: learners may keep what they saw."""
    seen = seen.copy()
    seen[positions] = other
    return seen


def merged(some: Seers, others: Seers) -> Seers:
    """Both, in rising order of the runs."""
    if not len(some[0]) or not len(others[0]):
        return some if len(some[0]) else others
    runs, seen = (np.concatenate(columns) for columns in zip(some, others, strict=True))
    order = np.argsort(runs)
    return runs[order], seen[order]
