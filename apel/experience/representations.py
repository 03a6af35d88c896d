"""What a learner sees of a step: which part of the observation, which reward, which end of an episode."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from apel.experience.channels import ChannelSpace
from apel.experience.frame_stacking import stacked_space
from apel.experience.joint_space import reduced
from apel.experience.parts import parts_of, whole
from apel.numerics.near_names import did_you_mean


@dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Bins:
    """``count`` equal bins between ``low`` and ``high``; values outside fall into the first or the last."""

    low: float
    high: float
    count: Annotated[int, Field(ge=1, le=1_000_000)]

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
    """A learner's view of what happens.

    Attributes
    ----------
    exclude:
        Names or positions of features that the learner does not see.
    bins:
        One entry per feature of a continuous observation (before exclusion), for learners that need finitely many
        states.
    channel:
        Which part of the observation it sees, of an environment with several (`apel.experience.channels`); exclusion
        and bins are of that part.
    stack:
        It sees its last so many views at once, along a new first axis; those before the first are like the first.
    reward:
        The signal that it learns from instead of the environment's reward.
    terminal:
        The signal that, where it is not zero, ends an episode for this learner alone: the next state's value is zero,
        and its stack starts anew.
    """

    exclude: tuple[str | int, ...] = ()
    bins: tuple[Bins, ...] = ()
    channel: str | None = None
    stack: Annotated[int, Field(ge=1, le=1_000)] = 1
    reward: str | None = None
    terminal: str | None = None

    def visible(self, features: Sequence[str]) -> list[int]:
        """Positions of the features that are seen.

        Raises
        ------
        ValueError
            If an excluded feature does not exist, or if none is left.
        """
        for name in self.exclude:
            if name not in features and name not in range(len(features)):
                message = f"exclude: found {name!r}, expected one of {list(features)}{did_you_mean(name, features)}"
                raise ValueError(message)
        seen = [i for i, name in enumerate(features) if name not in self.exclude and i not in self.exclude]
        if not seen:
            message = f"exclude: found {list(self.exclude)}, expected at least one of {list(features)} to be left"
            raise ValueError(message)
        return seen


class View:
    """A `Representation` applied to one observation space.

    It knows no past: stacking the last views is left to `apel.experience.sight`.

    Attributes
    ----------
    space:
        What the learner is told of: the observation space after all of it, stacking included.
    stack:
        See `Representation`.
    """

    _parts_of: spaces.Space[Any] | None = None

    def __init__(
        self, representation: Representation, space: spaces.Space[Any], features: Sequence[str] | None = None
    ) -> None:
        self._source: tuple[Any, ...] = (representation, space, tuple(features or ()))
        self._channel = _channel(representation, space)
        self._reward = _signal("reward", representation.reward, space)
        self._terminal = _signal("terminal", representation.terminal, space)
        if isinstance(space, ChannelSpace) and self._channel is not None:
            space = space[self._channel]
        names = tuple(features or _default_features(space))
        self._visible = representation.visible(names)
        self._bins = representation.bins
        self._is_whole = not representation.exclude and not representation.bins
        if self._bins and (len(self._bins) != len(names) or not isinstance(space, spaces.Box) or len(space.shape) != 1):
            message = f"bins: found {len(self._bins)} for {space}, expected one per feature of a one-dimensional Box"
            raise ValueError(message)
        self.stack = representation.stack
        self.space = stacked_space(space if self._is_whole else self._reduced(space), self.stack)

    def sees_like(self, other: View) -> bool:
        """Whether both make the same of every observation."""
        return self._source == other._source

    @property
    def is_whole(self) -> bool:
        """Whether the learner sees observations as they are."""
        return self._is_whole and self._channel is None

    @property
    def has_private_end(self) -> bool:
        """Whether an episode may end for the learner alone."""
        return self._terminal is not None

    def __call__(self, observation: Any) -> Any:
        """What the learner sees of ``observation``, a single one."""
        if self.is_whole:
            return observation
        return self.batch(np.asarray(observation)[None])[0]

    def batch(self, observations: NDArray[Any]) -> NDArray[Any]:
        """What the learner sees of observations ``[A, …]``; ``object[A]`` where it sees them with their parts."""
        if self._parts_of is not None:
            return whole(self._parts_of, observations)
        if self._channel is not None:
            observations = observations[self._channel]
        if self._is_whole:
            return observations
        if self._bins:
            columns = [self._bins[i].index(observations[:, i]) for i in self._visible]
            return np.stack(columns, axis=1).astype(np.int64)
        return observations[:, self._visible]

    def rewards(self, reward: NDArray[np.float64], observations: NDArray[Any]) -> NDArray[np.float64]:
        """``float64[A]``: what the learner is paid for steps that led to ``observations`` ``[A, …]``."""
        return reward if self._reward is None else observations[self._reward].astype(np.float64)

    def terminals(self, terminated: NDArray[np.bool_], observations: NDArray[Any]) -> NDArray[np.bool_]:
        """``bool[A]``: whether the episode ended there for the learner."""
        return terminated if self._terminal is None else terminated | (observations[self._terminal] != 0)

    def _reduced(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        if self._bins:
            return spaces.MultiDiscrete([self._bins[i].count for i in self._visible])
        if isinstance(space, spaces.MultiDiscrete):
            return reduced(space, self._visible)
        if isinstance(space, spaces.Box) and len(space.shape) == 1:
            return spaces.Box(space.low[self._visible], space.high[self._visible], dtype=space.dtype.type)
        message = (
            f"exclude: features can be left out of MultiDiscrete and one-dimensional Box spaces only, found {space}"
        )
        raise ValueError(message)


class WholeView(View):
    """Everything, for a learner whose members have representations of their own."""

    def __init__(self, space: spaces.Space[Any]) -> None:
        self._source = (None, space)
        self._channel = self._reward = self._terminal = None
        self._is_whole, self._bins, self._visible = True, (), []
        self.stack, self.space = 1, space


class PartsView(View):
    """Every part of an observation that stands as a vector, or as channels, in trajectories (`apel.experience.parts`).

    Parameters
    ----------
    representation:
        Its reward and its terminal; the rest is refused.
    space:
        With `apel.experience.parts.parts_of`.
    """

    def __init__(self, representation: Representation, space: spaces.Space[Any]) -> None:
        if representation != Representation(reward=representation.reward, terminal=representation.terminal):
            message = (
                f"found {representation} of a learner that sees whole observations, expected no exclude, bins or stack"
            )
            raise ValueError(message)
        parts = parts_of(space)
        assert parts is not None  # noqa: S101 - the caller has looked
        super().__init__(Representation(), parts)
        self._source = ("parts", representation, space)
        self._reward = _signal("reward", representation.reward, space)
        self._terminal = _signal("terminal", representation.terminal, space)
        self._parts_of = space

    @property
    def is_whole(self) -> bool:
        """What stands in trajectories is made into parts again."""
        return False


def _channel(representation: Representation, space: spaces.Space[Any]) -> str | None:
    if not isinstance(space, ChannelSpace):
        if representation.channel is not None:
            message = f"channel: found {representation.channel!r}, but the environment has no channels"
            raise ValueError(message)
        return None
    if representation.channel not in space.spaces:
        meant = did_you_mean(representation.channel, space.spaces)
        message = f"channel: found {representation.channel!r}, expected one of {list(space.spaces)}{meant}"
        raise ValueError(message)
    return representation.channel


def _signal(field: str, name: str | None, space: spaces.Space[Any]) -> str | None:
    signals = space.signals if isinstance(space, ChannelSpace) else ()
    if name is not None and name not in signals:
        meant = did_you_mean(name, signals)
        message = f"{field}: found {name!r}, expected one of the environment's signals: {list(signals)}{meant}"
        raise ValueError(message)
    return name


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
