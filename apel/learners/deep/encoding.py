"""From observations to what a memory stores, and from there to the inputs of a network."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.experience.frame_stacking import StackSpace
from apel.experience.joint_space import JointSpace, ReducedJointSpace
from apel.numerics.compiled import njit

Encoding = Literal["raw", "one_hot"]
Frames = NDArray[np.uint8]
"""``uint8[A, stack, bytes]``: observations as they are stored; most have a single frame."""
FLOATS, _BYTES, _CODES = range(3)


class Coding(NamedTuple):
    """How the bytes of a frame are read."""

    kind: int
    """Of ``float32``; single bytes; or ``int32``, of which each becomes a one-hot vector."""
    scale: float
    """Of single bytes."""
    sizes: NDArray[np.int64]
    """``int64[variables]``: lengths of the one-hot vectors."""


@njit
def encode(coding: Coding, frames: Frames, inputs: Any) -> None:
    """Write the inputs of one observation ``[stack, bytes]``, ``float32[…]``."""
    at = 0
    for k in range(frames.shape[0]):
        frame = frames[k]
        if coding.kind == FLOATS:
            numbers = frame.view(np.float32)
            for i in range(numbers.shape[0]):
                inputs[at + i] = numbers[i]
            at += numbers.shape[0]
        elif coding.kind == _BYTES:
            scale = np.float32(coding.scale)
            for i in range(frame.shape[0]):
                inputs[at + i] = np.float32(frame[i]) * scale
            at += frame.shape[0]
        else:
            codes = frame.view(np.int32)
            for i in range(codes.shape[0]):
                size = coding.sizes[i]
                for j in range(size):
                    inputs[at + j] = np.float32(0.0)
                inputs[at + min(max(np.int64(codes[i]), 0), size - 1)] = np.float32(1.0)
                at += size


@njit
def encode_all(coding: Coding, frames: Frames, inputs: Any) -> None:
    """Write ``inputs[:, 0]`` of observations ``[A, stack, bytes]``."""
    for i in range(frames.shape[0]):
        encode(coding, frames[i], inputs[i, 0])


class Encoder:
    """Makes ``float32`` inputs of observations.

    A Box goes in as it is (images of bytes divided by the largest value that they may have, such as 255; a Box without
    dimensions as a vector of one number). A Discrete observation is a one-hot vector, and so is each variable of a
    `JointSpace`, side by side. The variables of another MultiDiscrete one go in as numbers (``raw``), or as one-hot
    vectors side by side (``one_hot``).

    Attributes
    ----------
    observation_shape, shape:
        Of an observation, and of one input.
    frame_bytes:
        Of one frame, as a memory stores it.
    stack:
        How many frames an observation has, along its first axis (`apel.experience.frame_stacking`).
    coding:
        How stored frames are read.

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
        self.stack = space.size if isinstance(space, StackSpace) else 1
        sizes, self._starts = _one_hot_sizes(space, encoding)
        # Of a Box without dimensions the input is a vector of one number.
        self.shape = (int(sizes.sum()),) if len(sizes) else self.observation_shape or (1,)
        kind = _CODES if len(sizes) else _BYTES if _has_bytes(space) else FLOATS
        self._type = np.dtype((np.float32, np.uint8, np.int32)[kind])
        self.coding = Coding(kind, _scale(space), sizes)
        count = int(np.prod(self.observation_shape, dtype=np.int64))
        self.frame_bytes = count // self.stack * self._type.itemsize

    def stored(self, observation: NDArray[Any]) -> Frames:
        """Observations ``[A, …]`` as a memory stores them: copies."""
        if len(self._starts):
            observation = observation.reshape(len(observation), -1) - self._starts
        values = np.array(observation, dtype=self._type, order="C")
        return values.reshape(-1).view(np.uint8).reshape(len(values), self.stack, self.frame_bytes)

    @property
    def one_hot(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Number of values, and the first value, of each variable that becomes a one-hot vector."""
        return self.coding.sizes, self._starts

    @property
    def scale(self) -> float:
        """By which everything else is multiplied."""
        return self.coding.scale

    def __call__(self, observation: NDArray[Any]) -> NDArray[np.float32]:
        """``float32[A, *shape]`` of observations ``[A, …]``."""
        inputs = np.empty((len(observation), 1, int(np.prod(self.shape))), dtype=np.float32)
        encode_all(self.coding, self.stored(observation), inputs)
        return inputs.reshape(len(observation), *self.shape)


def _scale(space: spaces.Space[Any]) -> float:
    is_image = isinstance(space, spaces.Box) and len(space.shape) == 3 and space.dtype == np.uint8
    return float(np.float32(1 / space.high.max())) if is_image else 1.0  # type: ignore[attr-defined]


def _has_bytes(space: spaces.Space[Any]) -> bool:
    if isinstance(space, spaces.MultiBinary):
        return True
    return isinstance(space, spaces.Box) and space.dtype in (np.dtype(np.uint8), np.dtype(np.bool_))


def _one_hot_sizes(space: spaces.Space[Any], encoding: Encoding) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of values, and the first value, of each variable that becomes a one-hot vector; none where none does."""
    match space:
        case spaces.Discrete():
            return np.array([space.n], dtype=np.int64), np.array([space.start], dtype=np.int64)
        case spaces.MultiDiscrete() if encoding == "one_hot" or isinstance(space, JointSpace | ReducedJointSpace):
            return space.nvec.ravel().astype(np.int64), space.start.ravel().astype(np.int64)
    return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
