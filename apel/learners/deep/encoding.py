"""From observations to the inputs of a network, and to what a replay memory stores."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

Encoding = Literal["raw", "one_hot"]


class Encoder:
    """Makes ``float32`` inputs of observations.

    A Box goes in as it is (images of bytes divided by 255). A Discrete observation is a one-hot vector. The variables
    of a MultiDiscrete one go in as numbers (``raw``), or as one-hot vectors side by side (``one_hot``).

    Attributes
    ----------
    shape:
        Of one input.
    storage_type:
        The smallest type that holds an observation.
    observation_shape:
        Of one observation.

    Raises
    ------
    ValueError
        If the space is none of these.
    """

    def __init__(self, space: spaces.Space[Any], encoding: Encoding = "raw") -> None:
        if not isinstance(space, spaces.Box | spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary):
            message = f"found the observation space {space}, expected a Box, Discrete, MultiDiscrete or MultiBinary one"
            raise ValueError(message)
        self.observation_shape = tuple(space.shape or ())
        self._sizes: list[int] = []
        self._start = 0
        if isinstance(space, spaces.Discrete):
            self._sizes, self._start = [int(space.n)], int(space.start)
        elif isinstance(space, spaces.MultiDiscrete) and encoding == "one_hot":
            self._sizes = [int(size) for size in space.nvec]
        self.shape = (sum(self._sizes),) if self._sizes else self.observation_shape
        self.storage_type = _storage_type(space)
        self._scale = np.float32(1 / 255 if self.storage_type == np.uint8 and len(self.shape) == 3 else 1)

    def __call__(self, observation: NDArray[Any]) -> NDArray[np.float32]:
        """``float32[…, *shape]`` of observations ``[…, *observation_shape]``."""
        if not self._sizes:
            values = observation.astype(np.float32)
            return values if self._scale == 1 else values * self._scale
        values = (observation - self._start).reshape(-1, len(self._sizes))
        leading = observation.shape[: observation.ndim - len(self.observation_shape)]
        one_hot = np.zeros((math.prod(leading), *self.shape), dtype=np.float32)
        offsets = np.cumsum([0, *self._sizes[:-1]])
        np.put_along_axis(one_hot, values.astype(np.int64) + offsets, 1.0, axis=1)
        return one_hot.reshape(*leading, *self.shape)


def _storage_type(space: spaces.Space[Any]) -> np.dtype[Any]:
    match space:
        case spaces.Discrete():
            return np.min_scalar_type(int(space.start + space.n - 1)) if space.start >= 0 else np.dtype(np.int64)
        case spaces.MultiDiscrete():
            return np.min_scalar_type(int((space.start + space.nvec - 1).max()))
        case spaces.Box() if space.dtype in (np.dtype(np.uint8), np.dtype(np.bool_)):
            return np.dtype(space.dtype)
        case spaces.MultiBinary():
            return np.dtype(np.bool_)
    return np.dtype(np.float32)
