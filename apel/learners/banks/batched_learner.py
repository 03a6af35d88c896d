"""Learners of all runs of a shard, driven in lockstep: what a batched environment is to environments
(`apel.dynamics.batched_environment`).

A *batched learner* is to `Learner` what an array is to a number: every call concerns several runs at once, named by
their positions in the shard, and leaves the others alone. What a run's learner does must not depend on which other
runs are named in the same call, value for value.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.experience.trajectory import Trajectory
from apel.learners.base import State

NO_ERRORS: Mapping[int, BaseException] = MappingProxyType({})
"""Of learners that run no code of users."""


class EpisodePlayer(Protocol):
    """Plays whole episodes of a learner's runs, and learns from them, where that is the same as step by step."""

    def play(self, run: int, start: NDArray[Any]) -> Trajectory:
        """One episode of a run, of which `HasWorlds.start` made ``start``."""
        ...


class Transitions(NamedTuple):
    """One step of A runs as their learners see it, whoever acted (see `apel.learners.base.Transition`)."""

    observation: NDArray[Any]
    """``[A, …]``."""
    action: NDArray[Any]
    """``int64[A]``, counted from 0; ``[A, …]`` where actions are not Discrete (`apel.experience.action_form`)."""
    reward: NDArray[np.float64]
    next_observation: NDArray[Any]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    probability: NDArray[np.float64]
    """``float64[A, actions]``: μ(·|s) of whoever acted; NaN where it is not known. Where actions are not Discrete,
    ``float64[A, 1]``: that of the action.
    """


@runtime_checkable
class BatchedLearner(Protocol):
    """The learners of R runs.

    It is made as ``SomeBatchedLearner(observation_space, num_actions, seeds, **options)`` with a 64-bit seed per run.
    """

    off_policy: ClassVar[bool]

    @property
    def is_alone(self) -> bool:
        """Whether each run is computed by itself: none gains from another's company, and `learn` may be told several
        steps of one run in turn.
        """
        ...

    @property
    def errors(self) -> Mapping[int, BaseException]:
        """What users' code raised in the last call, by run; what the call gave for these runs means nothing."""
        ...

    def act(self, runs: Runs, observation: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """An action per run, and μ, both as in `Transitions`."""
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
        """Everything needed to go on exactly here, for all runs.

        Every array in it has a row for each run, so that the state of a single one can be taken out of it, and given to
        the learner of that run alone (`apel.learners.starting.of_run`); streams lie under ``stream`` or ``streams``.
        """
        ...

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        ...
