"""Observations in the one form in which all see them, whoever acts: an array of their space's shape and type.

Environments say the same thing in many forms: lists, tuples, numbers of other types, one array that is written again
at each step. What stands for the same observation is made the same here; what stands for none is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

_RELATIVE_TOLERANCE, _ABSOLUTE_TOLERANCE = 1e-5, 1e-6
"""How far beyond a bound a Box's observation may lie: what rounding to ``float32`` may do."""
_NUMBER_KINDS, _INTEGER_KINDS = "biuf", "biu"
_MOST_SHOWN = 120
_NONE: NDArray[np.int64] = np.zeros(0, dtype=np.int64)


class BorderError(ValueError):
    """What a user's code answered is not of the form that it declares, or that is agreed upon."""


class ObservationForm:
    """The form of the observations of a plain space (`apel.experience.channels.PLAIN_SPACES`), or of its actions.

    Parameters
    ----------
    space:
        The space.
    of:
        What its elements are. The bounds of actions are strict, and an infinite one is none.

    Attributes
    ----------
    shape:
        Of an observation.
    dtype:
        Its type.
    is_discrete:
        Whether its values are counted.
    """

    def __init__(self, space: spaces.Space[Any], of: Literal["observation", "action"] = "observation") -> None:
        self._space, self._of = space, of
        self.shape = tuple(space.shape or ())
        self.dtype = np.dtype(space.dtype)
        self._is_real = self.dtype.kind == "f"
        self.is_discrete = isinstance(space, spaces.Discrete | spaces.MultiDiscrete)
        self._is_number = isinstance(space, spaces.Discrete)
        self._low, self._high = self._bounds()

    def room(self, count: int) -> NDArray[Any]:
        """For ``count`` of them."""
        return np.zeros((count, *self.shape), dtype=self.dtype)

    def converted(self, observation: Any) -> NDArray[Any]:
        """An observation in this form; the same array where it has it already.

        Raises
        ------
        BorderError
            If it has another shape, or cannot be converted without loss (real numbers are rounded to the space's type).
        """
        if type(observation) is np.ndarray and observation.dtype == self.dtype and observation.shape == self.shape:
            return observation
        found = self._numbers(observation)
        if found.shape != self.shape:
            raise self._refused(observation, f"it has the shape {found.shape}, not {self.shape}")
        with np.errstate(invalid="ignore", over="ignore"):
            converted = found.astype(self.dtype)
        is_lost = np.isinf(converted) & np.isfinite(found) if self._is_real else converted != found
        if np.any(is_lost):
            raise self._refused(observation, f"{found[is_lost].flat[0]} cannot be stored as {self.dtype} without loss")
        return converted

    def write(self, observation: Any, into: NDArray[Any], position: int) -> None:
        """Copy an observation, converted, to a position of ``into`` (``[A, …]``).

        Raises
        ------
        BorderError
            See `converted`.
        """
        # The plain numbers of a Discrete space in a fraction of the time.
        is_number = self._is_number and type(observation) is int and -(2**63) <= observation < 2**63
        into[position] = observation if is_number else self.converted(observation)

    def checked(self, observation: Any, *, terminal: bool = False) -> NDArray[Any]:
        """A single observation in this form.

        Raises
        ------
        BorderError
            See `converted`; or if it is `outside`.
        """
        converted = self.converted(observation)
        if len(self.outside(converted[None], terminal=[terminal])):
            raise self.error_of(converted)
        return converted

    def outside(self, observations: NDArray[Any], *, terminal: Sequence[bool]) -> NDArray[np.int64]:
        """Positions of those of ``observations`` (``[A, …]``, in this form) that are no elements of the space.

        Where an episode ended with it (``terminal``, one truth value each) a Box's observation may lie beyond the
        bounds, since leaving them is what ends many episodes.
        """
        if self._low is None:
            return _NONE
        inside = (observations >= self._low) & (observations <= self._high)  # NaN is in no interval
        if np.count_nonzero(inside) == inside.size:
            return _NONE
        outside = ~inside.reshape(len(observations), -1).all(axis=1)
        if self._is_real:
            outside &= ~np.array(terminal) | np.isnan(observations).reshape(len(observations), -1).any(axis=1)
        return np.flatnonzero(outside)

    def error_of(self, observation: NDArray[Any]) -> BorderError:
        """What is to be said of one that is `outside`."""
        is_bad = ~((observation >= self._low) & (observation <= self._high))
        place = tuple(np.argwhere(is_bad)[0].tolist()) if self.shape else ()
        value = observation[place]
        where = f" at {list(place)}" if place else ""
        if value != value:
            return self._refused(observation, f"found no number{where}")
        if self._of == "action" and np.isinf(value):
            return self._refused(observation, f"{value}{where} is not finite")
        low, high = (np.broadcast_to(bound, self.shape)[place] for bound in self._plain_bounds())
        return self._refused(observation, f"{value}{where} is not from {low} to {high}")

    def _numbers(self, observation: Any) -> NDArray[Any]:
        """An array of numbers, of whatever type."""
        try:
            found = np.asarray(observation)
            if found.dtype == object and all(isinstance(one, Real) for one in found.flat):
                found = found.astype(np.float64 if self._is_real else self.dtype)
        except (ValueError, TypeError, OverflowError) as error:
            raise self._refused(observation, str(error).split(". ")[0]) from error
        if found.dtype.kind not in _NUMBER_KINDS:
            raise self._refused(observation, "it holds something that is no number")
        return found

    def _bounds(self) -> tuple[Any, Any]:
        """Between which all elements lie; None where the type says it all."""
        low, high = self._plain_bounds()
        if self._is_real and self._of == "action":
            largest = np.finfo(self.dtype).max
            return np.maximum(low, -largest), np.minimum(high, largest)
        if self._is_real:
            size = np.maximum(*(np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in (low, high)))
            slack = _ABSOLUTE_TOLERANCE + _RELATIVE_TOLERANCE * size
            with np.errstate(over="ignore"):
                return (low - slack).astype(self.dtype), (high + slack).astype(self.dtype)
        if self.dtype.kind in _INTEGER_KINDS and self.dtype.kind != "b":
            limits = np.iinfo(self.dtype)
            if np.all(low == limits.min) and np.all(high == limits.max):
                return None, None
        return low, high

    def _plain_bounds(self) -> tuple[NDArray[Any], NDArray[Any]]:
        match self._space:
            case spaces.Discrete():
                first = np.asarray(self._space.start)
                return first, first + self._space.n - 1
            case spaces.MultiDiscrete():
                return self._space.start, self._space.start + self._space.nvec - 1
            case spaces.Box():
                return self._space.low, self._space.high
        return np.array(0), np.array(1)

    def _refused(self, observation: Any, why: str) -> BorderError:
        said = observation.item() if isinstance(observation, np.generic) else observation
        return BorderError(f"found the {self._of} {shown(said)}, expected an element of {self._space}: {why}")


def plain_number(value: Any, name: str) -> float:
    """A reward or a signal as a plain number.

    Raises
    ------
    BorderError
        If it is none, or not finite; an array with dimensions is none.
    """
    if type(value) is float and math.isfinite(value):
        return value
    single = value[()] if isinstance(value, np.ndarray) and value.shape == () else value
    if not isinstance(single, int | float | np.number | np.bool_) or isinstance(single, np.complexfloating):
        message = f"found the {name} {shown(value)}, expected a number"
        raise BorderError(message)
    try:
        number = float(single)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        message = f"found the {name} {shown(value)}, expected a finite number"
        raise BorderError(message)
    return number


def shown(value: Any) -> str:
    """Anything that a user's code returned, in one line that is not too long."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # noqa: BLE001 - whatever a user's repr raises, there is something else to be told
        text = f"a {type(value).__name__}"
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}…"
