"""Observations with parts, of Dict and Tuple spaces: as the vectors that travel, and whole again for learners that take
them so.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.spaces.utils import unflatten
from numpy.typing import NDArray

from apel.experience.channels import ChannelSpace
from apel.experience.joint_space import JointSpace


class FlattenedSpace(spaces.Box):
    """The vectors that Gymnasium makes of the observations of a Dict or Tuple.

    Attributes
    ----------
    parts:
        The Dict or Tuple.
    """

    def __init__(self, parts: Any, flattened: spaces.Box) -> None:
        super().__init__(flattened.low, flattened.high, dtype=flattened.dtype.type)
        self.parts = parts


def parts_of(space: spaces.Space[Any]) -> spaces.Space[Any] | None:
    """The Dict or Tuple whose observations stand as elements of ``space`` in trajectories; None where there is none."""
    match space:
        case FlattenedSpace() | JointSpace():
            return space.parts
        case ChannelSpace():
            return spaces.Dict(space.spaces)
    return None


def whole(space: spaces.Space[Any], entries: NDArray[Any]) -> NDArray[Any]:
    """``object[A]``: the observations, with their parts, that are the ``entries`` ``[A, …]`` of ``space``.

    Their arrays are copies; Discrete parts are plain numbers.
    """
    observations = np.empty(len(entries), dtype=object)
    for position, entry in enumerate(entries):
        observations[position] = _whole(space, entry)
    return observations


def _whole(space: spaces.Space[Any], entry: NDArray[Any]) -> Any:
    match space:
        case FlattenedSpace():
            return _own(space.parts, unflatten(space.parts, entry))
        case JointSpace():
            return _element(space.parts, iter(entry.tolist()))
    return {name: _own(part, entry[name]) for name, part in space.items()}  # type: ignore[attr-defined]


def _own(space: spaces.Space[Any], observation: Any) -> Any:
    match space:
        case spaces.Dict():
            return {name: _own(part, observation[name]) for name, part in space.items()}
        case spaces.Tuple():
            return tuple(_own(part, one) for part, one in zip(space.spaces, observation, strict=True))
        case spaces.Discrete():
            return int(observation)
    return np.array(observation, dtype=space.dtype) if isinstance(observation, np.ndarray) else copy.copy(observation)


def _element(space: spaces.Space[Any], values: Iterator[int]) -> Any:
    """An element of a space whose leaves are finite, from its variables in order."""
    match space:
        case spaces.Dict():
            return {name: _element(part, values) for name, part in space.items()}
        case spaces.Tuple():
            return tuple(_element(part, values) for part in space.spaces)
        case spaces.Discrete():
            return next(values)
    count = int(np.prod(space.shape or ()))
    return np.array([next(values) for _ in range(count)], dtype=space.dtype).reshape(space.shape)
