"""Observations with parts, of Dict and Tuple spaces: each part in its one form, before they are made one vector."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
from gymnasium import spaces

from apel.experience.channels import PLAIN_SPACES
from apel.experience.observation_form import BorderError, ObservationForm, shown


class ConvertedParts(gymnasium.ObservationWrapper[Any, Any, Any]):
    """An environment whose observations have parts, with each plain part in its form (`ObservationForm`).

    Without this a vector would be made of whatever is said: `gymnasium.spaces.flatten` takes −1 of a Discrete for its
    last value.
    """

    def __init__(self, environment: gymnasium.Env[Any, Any]) -> None:
        super().__init__(environment)
        self._convert = converter(environment.observation_space)

    def observation(self, observation: Any) -> Any:
        """Its parts in their form."""
        return self._convert(observation)


class _Parts:
    """Converts what has parts."""

    def __init__(self, space: spaces.Dict | spaces.Tuple[Any]) -> None:
        self._space = space
        self._is_named = isinstance(space, spaces.Dict)
        parts = space.spaces.items() if isinstance(space, spaces.Dict) else enumerate(space.spaces)
        self._converters = {name: converter(part) for name, part in parts}

    def __call__(self, observation: Any) -> Any:
        """Every part converted; those that the space does not have are left out."""
        if self._is_named:
            missing = [
                name for name in self._converters if not isinstance(observation, Mapping) or name not in observation
            ]
            if missing:
                raise self._refused(observation, f"it has no {missing[0]!r}")
        elif not isinstance(observation, tuple | list) or len(observation) != len(self._converters):
            raise self._refused(observation, f"it is no tuple of {len(self._converters)}")
        parts = {name: self._part(name, convert, observation[name]) for name, convert in self._converters.items()}
        return parts if self._is_named else tuple(parts.values())

    def _part(self, name: Any, convert: Any, observation: Any) -> Any:
        try:
            return convert(observation)
        except BorderError as error:
            message = f"{name}: {error}"
            raise BorderError(message) from error

    def _refused(self, observation: Any, why: str) -> BorderError:
        return BorderError(f"found the observation {shown(observation)}, expected an element of {self._space}: {why}")


class _Plain:
    """Converts one plain part. The bounds of a Box are those of the vector, which is checked as a whole."""

    def __init__(self, space: spaces.Space[Any]) -> None:
        self._form = ObservationForm(space)
        self._is_number = isinstance(space, spaces.Discrete)

    def __call__(self, observation: Any) -> Any:
        converted = self._form.checked(observation) if self._form.is_discrete else self._form.converted(observation)
        return converted.item() if self._is_number else converted


class _Other:
    """Checks a part of which only its space knows the form, such as a text."""

    def __init__(self, space: spaces.Space[Any]) -> None:
        self._space = space

    def __call__(self, observation: Any) -> Any:
        if not self._space.contains(observation):
            message = f"found the observation {shown(observation)}, expected an element of {self._space}"
            raise BorderError(message)
        return observation


def converter(space: spaces.Space[Any]) -> Any:
    """What brings the observations of a space into their form, or raises a `BorderError`."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        return _Parts(space)
    return _Plain(space) if isinstance(space, PLAIN_SPACES) else _Other(space)
