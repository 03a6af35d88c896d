"""Actions of several finite variables as one, for the many learners that are for Discrete actions alone."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

_MOST = 100_000


class JointActions(gymnasium.ActionWrapper[Any, Any, Any]):
    """An environment with MultiDiscrete or MultiBinary actions, of which every combination has a number.

    Parameters
    ----------
    environment:
        With such actions, at most 100 000 combinations of them.

    Raises
    ------
    ValueError
        If it has others, or more.
    """

    def __init__(self, environment: gymnasium.Env[Any, Any]) -> None:
        super().__init__(environment)
        space: Any = environment.action_space
        match space:
            case spaces.MultiDiscrete():
                self._sizes, self._first = tuple(space.nvec.ravel().tolist()), space.start
            case spaces.MultiBinary():
                self._sizes, self._first = (2,) * math.prod(space.shape), np.zeros(space.shape, dtype=space.dtype)
            case _:
                message = f"found the action space {space}, expected a MultiDiscrete or a MultiBinary one"
                raise ValueError(message)
        count = math.prod(self._sizes)
        if count > _MOST:
            message = f"found the action space {space} with {count} combinations, expected at most {_MOST}"
            raise ValueError(message)
        self.action_space: Any = spaces.Discrete(count)

    def action(self, action: Any) -> Any:
        """The combination of that number; the last variable changes fastest."""
        values = np.array(np.unravel_index(int(action), self._sizes), dtype=self._first.dtype)
        return values.reshape(self._first.shape) + self._first
