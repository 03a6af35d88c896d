"""Observations of several finite variables (Blackjack's tuple of Discrete spaces) as one vector of whole numbers.

Tables take such a vector as a state; networks, as one-hot vectors side by side.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.experience.observation_form import BorderError, ObservationForm, shown

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
        ends = np.cumsum([len(names) for _, _, names in columns]).tolist()
        forms = [ObservationForm(space) for _, space in leaves]
        self._columns = [(form, slice(end - math.prod(form.shape), end)) for form, end in zip(forms, ends, strict=True)]

    def vector(self, observation: Any) -> NDArray[np.int64]:
        """``int64[features]`` of an observation of the parts, each in its form (`ObservationForm.converted`).

        A Tuple's may be a tuple, a list or an array. As with other observations, whether the values lie in the space is
        for whoever takes the vector to see: an experiment may say that they need not.

        Raises
        ------
        BorderError
            If a part is missing, is one too many for a Tuple, has another shape, or cannot be converted without loss.
        """
        vector = np.empty(len(self.features), dtype=np.int64)
        for (form, columns), (name, one) in zip(self._columns, _values(self.parts, observation, ""), strict=True):
            try:
                _write(form, one, vector[columns])
            except BorderError as error:
                message = f"{name}: {error}"
                raise BorderError(message) from error
        return vector


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
        yield from _leaves(part, _within(name, key))


def _within(name: str, key: Any) -> str:
    """The name of a part of a part."""
    return f"{name}.{key}" if name else str(key)


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


def _values(space: spaces.Space[Any], observation: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Name and observation of each leaf, in the order of `_leaves`."""
    if not isinstance(space, spaces.Tuple | spaces.Dict):
        yield name, observation
        return
    _check_parts(space, observation, name)
    for key, part in _parts(space):
        yield from _values(part, observation[key], _within(name, key))


def _check_parts(space: spaces.Tuple[Any] | spaces.Dict, observation: Any, name: str) -> None:
    """Parts of a Dict that it does not have are left out, as they are of all others."""
    if isinstance(space, spaces.Dict):
        missing = [key for key in space.spaces if not isinstance(observation, Mapping) or key not in observation]
        why = f"it has no {missing[0]!r}" if missing else ""
    else:
        is_whole = _is_row(observation) and len(observation) == len(space.spaces)
        why = "" if is_whole else f"it is no tuple of {len(space.spaces)}"
    if why:
        where = f"{name}: " if name else ""
        message = f"{where}found the observation {shown(observation)}, expected an element of {space}: {why}"
        raise BorderError(message)


def _is_row(observation: Any) -> bool:
    return isinstance(observation, tuple | list) or (isinstance(observation, np.ndarray) and observation.ndim > 0)


def _write(form: ObservationForm, observation: Any, into: NDArray[np.int64]) -> None:
    """Copy one part, converted, to its variables."""
    if form.shape:
        into[:] = form.converted(observation).ravel()
    else:
        form.write(observation, into, 0)
