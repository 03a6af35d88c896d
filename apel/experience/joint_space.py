"""Observations of several finite variables (Blackjack's tuple of Discrete spaces) as one vector of whole numbers.

Tables take such a vector as a state; networks, as one-hot vectors side by side.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

_Leaf = spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary


class JointSpace(spaces.MultiDiscrete):
    """The variables of a Tuple or Dict whose parts, however deep, are Discrete, MultiDiscrete or MultiBinary.

    Attributes
    ----------
    features:
        Names of the variables: their positions (``"0"``) or keys, those of parts within parts behind a dot, and those
        of a vector by its positions (``"hand.1"``).
    parts:
        The Tuple or Dict.
    """

    def __init__(self, parts: spaces.Tuple[Any] | spaces.Dict) -> None:
        leaves = list(_leaves(parts, ""))
        columns = [_variables(space, name) for name, space in leaves]
        super().__init__(
            np.concatenate([count for count, _, _ in columns]), start=np.concatenate([start for _, start, _ in columns])
        )
        self.features = tuple(name for _, _, names in columns for name in names)
        self.parts = parts

    def vector(self, observation: Any) -> NDArray[np.int64]:
        """``int64[features]`` of an observation of the parts.

        Raises
        ------
        KeyError, IndexError, ValueError
            If it is none.
        """
        return np.concatenate(list(_values(self.parts, observation)), dtype=np.int64, casting="unsafe")


class ReducedJointSpace(spaces.MultiDiscrete):
    """Some variables of a `JointSpace`."""


def is_joint(space: spaces.Space[Any]) -> bool:
    """Whether `JointSpace` is for observations of this space."""
    return isinstance(space, spaces.Tuple | spaces.Dict) and bool(len(space)) and _is_finite(space)


def reduced(space: spaces.MultiDiscrete, visible: Sequence[int]) -> spaces.MultiDiscrete:
    """The variables at some positions alone."""
    kind = ReducedJointSpace if isinstance(space, JointSpace) else spaces.MultiDiscrete
    return kind(space.nvec[visible], start=space.start[visible])


def _parts(space: spaces.Space[Any]) -> list[tuple[Any, spaces.Space[Any]]]:
    match space:
        case spaces.Tuple():
            return list(enumerate(space.spaces))
        case spaces.Dict():
            return list(space.spaces.items())
    return []


def _is_finite(space: spaces.Space[Any]) -> bool:
    if isinstance(space, spaces.Tuple | spaces.Dict):
        return all(_is_finite(part) for _, part in _parts(space))
    return isinstance(space, _Leaf)


def _leaves(space: spaces.Space[Any], name: str) -> Iterator[tuple[str, Any]]:
    if not isinstance(space, spaces.Tuple | spaces.Dict):
        yield name, space
    for key, part in _parts(space):
        yield from _leaves(part, f"{name}.{key}" if name else str(key))


def _variables(space: _Leaf, name: str) -> tuple[NDArray[np.int64], NDArray[np.int64], list[str]]:
    """Number of values, first value and name of each variable of a part."""
    match space:
        case spaces.Discrete():
            return np.array([space.n]), np.array([space.start]), [name]
        case spaces.MultiDiscrete():
            count, start = space.nvec.ravel(), space.start.ravel()
        case _:
            count = np.full(int(np.prod(space.shape)), 2)
            start = np.zeros_like(count)
    return count, start, [f"{name}.{i}" for i in range(len(count))]


def _values(space: spaces.Space[Any], observation: Any) -> Iterator[NDArray[Any]]:
    if not isinstance(space, spaces.Tuple | spaces.Dict):
        yield np.asarray(observation).ravel()
    for key, part in _parts(space):
        yield from _values(part, observation[key])
