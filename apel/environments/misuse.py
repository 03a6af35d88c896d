"""What every environment refuses in `step`."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

NO_EPISODE = -1
"""Steps of a run without an episode under way."""


def check_step(action: Any, space: spaces.Space[Any], steps: int) -> None:
    """Refuse an action that does not exist, and any where ``steps`` is `NO_EPISODE`.

    Raises
    ------
    ValueError
        If there is no such action.
    RuntimeError
        If no episode is under way.
    """
    if not space.contains(action):
        message = f"found the action {action!r}, expected one of {space}"
        raise ValueError(message)
    if steps == NO_EPISODE:
        message = "step() was called without an episode under way: call reset() first"
        raise RuntimeError(message)


def check_under_way(steps: NDArray[np.int64]) -> None:
    """Refuse to step runs of which one has `NO_EPISODE` for its steps.

    Raises
    ------
    RuntimeError
        If there is one.
    """
    if (steps == NO_EPISODE).any():
        message = "step() was called for a run without an episode under way: call reset() first"
        raise RuntimeError(message)
