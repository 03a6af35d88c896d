"""Several views of one step: environments whose observations have named parts, and that say more than one reward.

In trajectories such a step is one element of a structured array, with a field for each *channel* (a part of the
observation) and for each *signal* (a number of the step that led there, such as a private reward, or whether a life was
lost). Whatever handles trajectories need not know of any of it; each learner's representation picks its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.experience.observation_form import BorderError, ObservationForm, plain_number

SIGNAL_TYPE = np.dtype(np.float32)
PLAIN_SPACES = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
"""Of what an observation, or a channel of one, may be an element."""


class ChannelSpace(spaces.Dict):
    """The observations of an environment with channels.

    Attributes
    ----------
    signals:
        Names of its signals.
    entry_type:
        Structured type of a step in a trajectory.
    forms:
        Of each channel.
    """

    def __init__(self, channels: spaces.Dict, signals: Sequence[str]) -> None:
        super().__init__(channels.spaces)
        self.signals = tuple(signals)
        fields = [(name, _field_type(space), space.shape or ()) for name, space in channels.items()]
        names = [*channels, *self.signals]
        if len(set(names)) != len(names):
            message = f"found the channels {list(channels)} and the signals {list(signals)}, expected different names"
            raise ValueError(message)
        self.entry_type = np.dtype([*fields, *((name, SIGNAL_TYPE) for name in self.signals)])
        self.forms = {name: ObservationForm(space) for name, space in self.items()}

    def entry(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> NDArray[Any]:
        """A step as it stands in a trajectory, an array without dimensions.

        Raises
        ------
        KeyError
            If the environment left out a channel or a signal.
        BorderError
            If one of them is of another form.
        """
        entry = np.empty((), dtype=self.entry_type)
        for name, form in self.forms.items():
            try:
                # Entries hold discrete values in as few bytes as these need, so that no other fits.
                entry[name] = form.checked(observation[name]) if form.is_discrete else form.converted(observation[name])
            except BorderError as error:
                message = f"{name}: {error}"
                raise BorderError(message) from error
        for name in self.signals:
            entry[name] = plain_number(info[name], f"signal {name!r}")
        return entry

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ChannelSpace) and super().__eq__(other) and self.signals == other.signals

    __hash__ = None  # type: ignore[assignment] # as of all spaces that can be equal


def signals_of(environment: gymnasium.Env[Any, Any]) -> tuple[str, ...] | None:
    """The signals that an environment declares as its attribute ``signals``; None where it declares none."""
    if not environment.has_wrapper_attr("signals"):
        return None
    signals: Sequence[str] = environment.get_wrapper_attr("signals")
    return tuple(signals)


class EntryForm:
    """What `ObservationForm` is to plain spaces, of a `ChannelSpace` whose entries are made already.

    Attributes
    ----------
    shape, dtype:
        Of an entry.
    """

    def __init__(self, space: ChannelSpace) -> None:
        self.shape, self.dtype = (), space.entry_type
        self._forms = space.forms

    def write(self, entry: Any, into: NDArray[Any], position: int) -> None:
        """Copy an entry to a position of ``into`` (``[A]``)."""
        into[position] = entry

    def outside(self, entries: NDArray[Any], *, terminal: Sequence[bool]) -> NDArray[np.int64]:
        """Positions of those of ``entries`` (``[A]``) of which a channel is no element of its space."""
        found = [form.outside(entries[name], terminal=terminal) for name, form in self._forms.items()]
        return np.unique(np.concatenate(found)).astype(np.int64)

    def error_of(self, entry: NDArray[Any]) -> BorderError:
        """What is to be said of one that is `outside`."""
        never = [False]
        for name, form in self._forms.items():
            if len(form.outside(entry[name][None], terminal=never)):
                return BorderError(f"{name}: {form.error_of(entry[name])}")
        raise AssertionError


def form_of(space: spaces.Space[Any]) -> ObservationForm | EntryForm:
    """In which form the observations of an environment are shown to all."""
    return EntryForm(space) if isinstance(space, ChannelSpace) else ObservationForm(space)


class ChannelledEnvironment(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment whose observations are the entries of its `ChannelSpace`.

    Parameters
    ----------
    environment:
        With observations of a Dict space of plain spaces, and with every signal in each ``info``.
    signals:
        What it declares.
    """

    def __init__(self, environment: gymnasium.Env[Any, Any], signals: Sequence[str]) -> None:
        super().__init__(environment)
        channels = environment.observation_space
        if not isinstance(channels, spaces.Dict) or not all(isinstance(one, PLAIN_SPACES) for one in channels.values()):
            message = f"found signals of an environment with the observations {channels}, expected a Dict of plain ones"
            raise ValueError(message)
        self._space = ChannelSpace(channels, signals)
        self.observation_space = self._space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """See `gymnasium.Env`."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._space.entry(observation, info), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """See `gymnasium.Env`."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._space.entry(observation, info), reward, terminated, truncated, info


def _field_type(space: spaces.Space[Any]) -> np.dtype[Any]:
    """As few bytes as its values need: what is broadcast is mostly this."""
    return integer_type(space) if isinstance(space, spaces.Discrete | spaces.MultiDiscrete) else np.dtype(space.dtype)


def integer_type(space: spaces.Discrete | spaces.MultiDiscrete) -> np.dtype[Any]:
    """The smallest integers that hold all values of ``space``."""
    count = space.n if isinstance(space, spaces.Discrete) else space.nvec
    return np.result_type(*map(np.min_scalar_type, (np.min(space.start), np.max(space.start + count - 1))))
