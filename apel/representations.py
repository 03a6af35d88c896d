"""What a learner sees of the raw observation: some of its features, continuous ones in bins."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass


@dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Bins:
    """``count`` equal bins between ``low`` and ``high``; values outside fall into the first or the last."""

    low: float
    high: float
    count: Annotated[int, Field(ge=1)]

    def index(self, value: float | NDArray[np.floating[Any]]) -> NDArray[np.int64]:
        """The bin that each ``value`` falls into, 0 … ``count`` − 1."""
        return np.searchsorted(self._edges, value, side="right")

    @cached_property
    def _edges(self) -> NDArray[np.float64]:
        return np.linspace(self.low, self.high, self.count + 1)[1:-1]

    @model_validator(mode="after")
    def _ordered(self) -> Bins:
        if self.low >= self.high:
            message = f"found low {self.low} and high {self.high}, expected low below high"
            raise ValueError(message)
        return self


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Representation:
    """A learner's view of the raw observation.

    Attributes
    ----------
    exclude:
        Names or positions of features that the learner does not see.
    bins:
        One entry per feature of a continuous observation (before exclusion), for learners that need finitely many
        states.
    """

    exclude: tuple[str | int, ...] = ()
    bins: tuple[Bins, ...] = ()

    def visible(self, features: Sequence[str]) -> list[int]:
        """Positions of the features that are seen.

        Raises
        ------
        ValueError
            If an excluded feature does not exist, or if none is left.
        """
        for name in self.exclude:
            if name not in features and name not in range(len(features)):
                message = f"exclude: found {name!r}, expected one of {list(features)}"
                raise ValueError(message)
        seen = [i for i, name in enumerate(features) if name not in self.exclude and i not in self.exclude]
        if not seen:
            message = f"exclude: found {list(self.exclude)}, expected at least one of {list(features)} to be left"
            raise ValueError(message)
        return seen


class View:
    """A `Representation` applied to one observation space.

    Attributes
    ----------
    space:
        What the learner is told of: the observation space after exclusion and quantisation.
    """

    def __init__(
        self, representation: Representation, space: spaces.Space[Any], features: Sequence[str] | None = None
    ) -> None:
        names = tuple(features or _default_features(space))
        self._visible = representation.visible(names)
        self._bins = representation.bins
        self._is_identity = not representation.exclude and not representation.bins
        if self._bins and (len(self._bins) != len(names) or not isinstance(space, spaces.Box) or len(space.shape) != 1):
            message = f"bins: found {len(self._bins)} for {space}, expected one per feature of a one-dimensional Box"
            raise ValueError(message)
        self.space = space if self._is_identity else self._reduced(space)

    def __call__(self, observation: Any) -> Any:
        """What the learner sees of ``observation``."""
        if self._is_identity:
            return observation
        values = np.asarray(observation)
        if self._bins:
            return np.array([self._bins[i].index(float(values[i])) for i in self._visible], dtype=np.int64)
        return values[self._visible]

    def batch(self, observations: NDArray[Any]) -> NDArray[Any]:
        """What the learner sees of observations ``[A, …]``."""
        if self._is_identity:
            return observations
        if self._bins:
            columns = [self._bins[i].index(observations[:, i]) for i in self._visible]
            return np.stack(columns, axis=1).astype(np.int64)
        return observations[:, self._visible]

    def _reduced(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        if self._bins:
            return spaces.MultiDiscrete([self._bins[i].count for i in self._visible])
        if isinstance(space, spaces.MultiDiscrete):
            return spaces.MultiDiscrete(space.nvec[self._visible])
        if isinstance(space, spaces.Box) and len(space.shape) == 1:
            return spaces.Box(space.low[self._visible], space.high[self._visible], dtype=space.dtype.type)
        message = (
            f"exclude: features can be left out of MultiDiscrete and one-dimensional Box spaces only, found {space}"
        )
        raise ValueError(message)


def _default_features(space: spaces.Space[Any]) -> list[str]:
    shape = space.shape
    if shape is None or len(shape) != 1:
        return ["state"]
    return [f"feature_{i}" for i in range(shape[0])]


def state_rows(representation: Representation, features: Sequence[str], values: NDArray[np.int64]) -> NDArray[np.int32]:
    """For tables: the row of each state of a finite environment, ``int32[states]``.

    States that the learner cannot tell apart share a row. ``values`` is ``int64[states, features]``.
    """
    seen = values[:, representation.visible(features)]
    sizes = seen.max(axis=0) + 1
    return np.ravel_multi_index(tuple(seen.T), tuple(sizes)).astype(np.int32)
