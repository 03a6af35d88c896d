"""Actions in the one form in which all see them, whatever their space: what `observation_form` is to observations.

What is so for discrete actions alone (that they are counted, and that μ(·|s) is a row with all of them) is said here.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.experience.observation_form import BorderError, ObservationForm, shown

ACTION_SPACES = (spaces.Discrete, spaces.Box, spaces.MultiDiscrete, spaces.MultiBinary)
"""Of what an action may be an element."""


class ActionForm:
    """The form of the actions of an environment.

    Actions of a Discrete space are whole numbers; among banks and environments they are counted from 0, wherever the
    space begins, and μ is a row ``[A, n]`` of the probabilities of all. Of every other space they are arrays of its
    shape and type, ``[A, *shape]``, and μ is a column ``[A, 1]``: the density, or the probability, of the action that
    was taken. In trajectories there are the environment's own actions. NaN is a μ that is not known.

    Attributes
    ----------
    space:
        The environment's.
    is_discrete:
        Whether it is a Discrete one.
    first:
        What a Discrete space begins with.
    width:
        Columns of μ.

    Raises
    ------
    ValueError
        If actions of this space cannot be played.
    """

    def __init__(self, space: Any) -> None:
        if not isinstance(space, ACTION_SPACES):
            names = ", ".join(kind.__name__ for kind in ACTION_SPACES)
            message = f"found the action space {space}, expected one of {names}"
            raise ValueError(message)
        self.space: Any = space
        self.is_discrete = isinstance(space, spaces.Discrete)
        self.width = int(space.n) if isinstance(space, spaces.Discrete) else 1
        self.first = int(space.start) if isinstance(space, spaces.Discrete) else 0
        self._arrays = None if isinstance(space, spaces.Discrete) else ObservationForm(space, of="action")

    def room(self, count: int) -> NDArray[Any]:
        """For ``count`` actions, as banks and environments have them."""
        return np.zeros(count, dtype=np.int64) if self._arrays is None else self._arrays.room(count)

    def unknown(self, count: int) -> NDArray[np.float64]:
        """μ of ``count`` steps of which it is not known."""
        return np.full((count, self.width), np.nan)

    def counted(self, actions: NDArray[Any]) -> NDArray[Any]:
        """Of the environment's own actions (``[A, …]``): as banks have them."""
        return actions.astype(np.int64) - self.first if self.is_discrete else actions

    def uncounted(self, actions: NDArray[Any]) -> NDArray[Any]:
        """Of actions as banks have them: the environment's own."""
        return actions + self.first if self.is_discrete else actions

    def rows(self, actions: NDArray[Any]) -> list[Any]:
        """The environment's own actions one by one: plain numbers, or arrays that nobody else has."""
        return actions.tolist() if self.is_discrete else list(actions.copy())

    def column(self, rows: Sequence[Any]) -> NDArray[Any]:
        """What `rows` was given."""
        if self._arrays is None:
            return np.array(rows, dtype=np.int64)
        return np.array(rows, dtype=self._arrays.dtype).reshape(len(rows), *self._arrays.shape)

    def converted(self, answer: Any) -> NDArray[Any]:
        """An action that a learner answered, in this form; of spaces that are not Discrete.

        It is converted as observations are, but its bounds are strict, and nothing is clipped.

        Raises
        ------
        BorderError
            If it is no element of the space, or not finite.
        """
        assert self._arrays is not None  # noqa: S101 - the caller has looked
        return self._arrays.checked(answer)

    def told(self, mu: NDArray[np.float64]) -> list[Any]:
        """μ of A steps as a plain learner is told: a row of probabilities, or a number; None where it is not known."""
        known: list[bool] = np.logical_not(np.isnan(mu).any(axis=1)).tolist()
        values = list(mu.copy()) if self.is_discrete else mu[:, 0].tolist()
        return [value if is_known else None for value, is_known in zip(values, known, strict=True)]

    def sample(self, random: np.random.Generator, count: int) -> NDArray[Any]:
        """``count`` actions at random, as banks have them."""
        if self.is_discrete:
            return random.integers(self.width, size=count)
        space = copy.deepcopy(self.space)
        space.seed(int(random.integers(2**31)))
        return np.stack([space.sample() for _ in range(count)])


def density_of(answer: Any) -> float:
    """The density, or the probability, that a learner gives to the action that it took.

    Raises
    ------
    BorderError
        If it is no finite number from 0 on.
    """
    try:
        value = float(answer) if np.ndim(answer) == 0 else math.nan
    except (TypeError, ValueError):
        value = math.nan
    if not (math.isfinite(value) and value >= 0.0):
        message = f"found {shown(answer)} for μ, expected the density of the action: a finite number from 0 on, or None"
        raise BorderError(message)
    return value
