"""The two levels of learner: the black box for one run that a user writes, and the bank that holds it for many runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from apel.book import Book
from apel.selection import Selector
from apel.trajectory import Episodes, Trajectory, TrajectoryBatch

State = dict[str, Any]
"""What a checkpoint holds: a dictionary of arrays, numbers, strings, booleans, None, and lists or dictionaries of
these.
"""

Performance = Literal["return", "negative_length"] | Callable[[Trajectory], float]
"""How good an episode was, larger is better: by name, or as a function of its trajectory."""


class Transition(NamedTuple):
    """One step as every learner sees it, whoever acted."""

    observation: Any
    action: int
    reward: float
    next_observation: Any
    terminated: bool
    """The environment ended the episode here: the next state's value is zero."""
    truncated: bool
    """The episode was cut off here: the next state still has a value."""
    probability: NDArray[np.float64] | None
    """``float64[actions]``: μ(·|s) of whoever acted, or None where it is not known."""


@runtime_checkable
class Learner(Protocol):
    """One off-policy learner of one run: a black box to the ensemble.

    It is made as ``SomeLearner(observation_space, action_space, seed, **options)``. While it acts the loop is

        action, probability = learner.act(observation)
        learner.learn(Transition(observation, action, …))

    and `end_episode` after the last step. On the episodes of others it gets the same transitions in the same order,
    without the calls of `act`. All its randomness comes from ``seed``.
    """

    off_policy: ClassVar[bool]
    """Whether it may learn from what others did; a learner that may not is refused by an ensemble."""

    def act(self, observation: Any) -> tuple[int, NDArray[np.float64] | None]:
        """Choose an action; also its probabilities μ(·|s), ``float64[actions]``, or None if unknown."""
        ...

    def learn(self, transition: Transition) -> None:
        """Learn from one step."""
        ...

    def end_episode(self) -> None:
        """The episode is over, own or another's."""
        ...

    def state(self) -> State:
        """Everything needed to go on exactly here."""
        ...

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        ...


@runtime_checkable
class HasActionValues(Protocol):
    """A learner that can say what it thinks of each action: it can vote, and be evaluated without exploring."""

    def action_values(self, observation: Any) -> NDArray[np.float64]:
        """``float64[actions]``: what its policy acts on; larger is better. Draws nothing, changes nothing."""
        ...


@runtime_checkable
class Freezable(Protocol):
    """A learner that can act on what it knew some time ago while it goes on learning (ESBAS, Algorithm 6)."""

    def freeze(self) -> None:
        """From now on act on what is known now, until the next call."""
        ...


class StreakLimit(NamedTuple):
    """How long a host may keep a run before it reports back. It changes no result, only the number of messages."""

    episodes: int
    """Episodes per run and round, at least 1."""
    steps: int
    """Environment steps per host and round, shared by its runs; the episode under way is finished."""


class Failure(NamedTuple):
    """A run that cannot go on."""

    run: int
    """Position in the shard."""
    episode: int
    error: str


@dataclass(frozen=True)
class Played:
    """What a bank answers after playing: a few numbers per episode, and (where others will learn) the trajectories."""

    episodes: Episodes
    batch: TrajectoryBatch | None = None
    failures: tuple[Failure, ...] = ()


class LearnerBank(Protocol):
    """The same learner for every run of a shard."""

    def play(
        self, runs: Sequence[int], book: Book, selector: Selector, me: int, limit: StreakLimit, *, record: bool
    ) -> Played:
        """Play a streak of each run: episodes, learning while acting, for as long as ``book`` names learner ``me``.

        Advances ``book``. Trajectories are returned only with ``record``.
        """
        ...

    def learn(self, batch: TrajectoryBatch) -> tuple[Failure, ...]:
        """Learn from the episodes that other learners played."""
        ...

    def state(self) -> State:
        """Everything needed to go on exactly here, for all runs."""
        ...

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        ...
