"""Learners that hold all runs of a shard in stacked arrays, driven in lockstep (`apel.batched`).

A *stacked learner* is to `Learner` what an array is to a number: every call concerns several runs at once, named by
their positions in the shard, and leaves the others alone. What a run's learner does must not depend on which other
runs are named in the same call, value for value.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from apel.batched import Runs
from apel.learners.base import State


class Transitions(NamedTuple):
    """One step of A runs as their learners see it, whoever acted (see `apel.learners.base.Transition`)."""

    observation: NDArray[Any]
    """``[A, …]``."""
    action: NDArray[np.int64]
    """``int64[A]``, counted from 0."""
    reward: NDArray[np.float64]
    next_observation: NDArray[Any]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    probability: NDArray[np.float64]
    """``float64[A, actions]``: μ(·|s) of whoever acted; NaN where it is not known."""


@runtime_checkable
class StackedLearner(Protocol):
    """The learners of R runs.

    It is made as ``SomeStackedLearner(observation_space, num_actions, seeds, **options)`` with a 64-bit seed per run.
    """

    off_policy: ClassVar[bool]

    def act(self, runs: Runs, observation: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """``int64[A]``, an action per run counted from 0, and ``float64[A, actions]``, all of their probabilities."""
        ...

    def learn(self, runs: Runs, transitions: Transitions) -> None:
        """Learn from one step of each run."""
        ...

    def lag(self, runs: Runs) -> NDArray[np.int64]:
        """``int64[A]``: in how many steps each of these runs learns next. It costs least where they learn together."""
        ...

    def end_episode(self, runs: Runs) -> None:
        """The episode of each of these runs is over, own or another's."""
        ...

    def action_values(self, runs: Runs, observation: NDArray[Any]) -> NDArray[np.float64]:
        """``float64[A, actions]``: what the policies act on; draws nothing, changes nothing."""
        ...

    def freeze(self, runs: Runs) -> None:
        """From now on these runs act on what is known now, until the next call."""
        ...

    def state(self) -> State:
        """Everything needed to go on exactly here, for all runs."""
        ...

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        ...
