"""From observations to the inputs of a network, and to what a replay memory stores."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.channels import integer_type
from apel.stacking import StackSpace

Encoding = Literal["raw", "one_hot"]


class Encoder:
    """Makes ``float32`` inputs of observations.

    A Box goes in as it is (images of bytes divided by the largest value that they may have, such as 255). A Discrete
    observation is a one-hot vector. The variables of a MultiDiscrete one go in as numbers (``raw``), or as one-hot
    vectors side by side (``one_hot``).

    Attributes
    ----------
    shape:
        Of one input.
    storage_type:
        The smallest type that holds an observation.
    observation_shape:
        Of one observation.
    stack:
        How many frames an observation has, along its first axis (`apel.stacking`).

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
        self.storage_type = _storage_type(space)
        self.stack = space.size if isinstance(space, StackSpace) else 1
        self._sizes, self._starts = _one_hot_sizes(space, encoding)
        self.shape = (int(self._sizes.sum()),) if len(self._sizes) else self.observation_shape
        self._scale = _scale(space)

    def __call__(self, observation: NDArray[Any]) -> NDArray[np.float32]:
        """``float32[…, *shape]`` of observations ``[…, *observation_shape]``."""
        if not len(self._sizes):
            values = observation.astype(np.float32)
            return values if self._scale == 1 else values * self._scale
        leading = observation.shape[: observation.ndim - len(self.observation_shape)]
        # What a memory never wrote is zero, and maybe no observation; whatever it gives is ignored.
        codes = observation.reshape(-1, len(self._sizes)).astype(np.int64) - self._starts
        offsets = np.cumsum(self._sizes) - self._sizes
        one_hot = np.zeros((math.prod(leading), *self.shape), dtype=np.float32)
        np.put_along_axis(one_hot, np.clip(codes, 0, self._sizes - 1) + offsets, 1.0, axis=1)
        return one_hot.reshape(*leading, *self.shape)


def _scale(space: spaces.Space[Any]) -> np.float32:
    is_image = isinstance(space, spaces.Box) and len(space.shape) == 3 and space.dtype == np.uint8
    return np.float32(1 / space.high.max() if is_image else 1)  # type: ignore[attr-defined]


def _one_hot_sizes(space: spaces.Space[Any], encoding: Encoding) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of values, and the first value, of each variable that becomes a one-hot vector; none where none does."""
    match space:
        case spaces.Discrete():
            return np.array([space.n], dtype=np.int64), np.array([space.start], dtype=np.int64)
        case spaces.MultiDiscrete() if encoding == "one_hot":
            return space.nvec.ravel().astype(np.int64), space.start.ravel().astype(np.int64)
    return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)


def _storage_type(space: spaces.Space[Any]) -> np.dtype[Any]:
    match space:
        case spaces.Discrete() | spaces.MultiDiscrete():
            return integer_type(space)
        case spaces.Box() if space.dtype in (np.dtype(np.uint8), np.dtype(np.bool_)):
            return np.dtype(space.dtype)
        case spaces.MultiBinary():
            return np.dtype(np.bool_)
    return np.dtype(np.float32)
