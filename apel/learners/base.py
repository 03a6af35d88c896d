"""The two levels of learner: the black box for one run that a user writes, and the bank that holds it for many runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from apel.experience.trajectory import Episodes, Trajectory, TrajectoryBatch
from apel.run.selection import Selector
from apel.run.state import Book
from apel.run.user_code import Part, in_a_line, part_of, place_of, trace_of

State = dict[str, Any]
"""What a checkpoint holds: a dictionary of arrays, numbers, strings, booleans, None, and lists or dictionaries of
these.
"""

Performance = Literal["return", "negative_length"] | Callable[[Trajectory], float]
"""How good an episode was, larger is better: by name, or as a function of its trajectory."""


class Transition(NamedTuple):
    """One step as every learner sees it, whoever acted."""

    observation: Any
    action: Any
    """A whole number; an array where the environment's actions are not Discrete."""
    reward: float
    next_observation: Any
    terminated: bool
    """The environment ended the episode here: the next state's value is zero."""
    truncated: bool
    """The episode was cut off here: the next state still has a value."""
    probability: NDArray[np.float64] | float | None
    """``float64[actions]``: μ(·|s) of whoever acted, or None where it is not known. Where actions are not Discrete, a
    number: the density, or the probability, of the action.
    """


@runtime_checkable
class Learner(Protocol):
    """One off-policy learner of one run: a black box to the ensemble.

    It is made as ``SomeLearner(observation_space, action_space, seed, **options)``. While it acts the loop is

        action, probability = learner.act(observation)
        learner.learn(Transition(observation, action, …))

    and `end_episode` after the last step. On the episodes of others it gets the same transitions in the same order,
    without the calls of `act`: by these it knows its own. All its randomness comes from ``seed``.
    """

    off_policy: ClassVar[bool]
    """Whether it may learn from what others did; a learner that may not is refused by an ensemble."""

    def act(self, observation: Any) -> tuple[Any, NDArray[np.float64] | float | None]:
        """Choose an action; also μ, as in `Transition`, or None if unknown."""
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
class HasGreedyAction(Protocol):
    """A learner that can say what it would do if it did not explore: it can be evaluated without action values."""

    def greedy_action(self, observation: Any) -> Any:
        """The action. Draws nothing, changes nothing."""
        ...


@runtime_checkable
class Freezable(Protocol):
    """A learner that can act on what it knew some time ago while it goes on learning (ESBAS, Algorithm 6)."""

    def freeze(self) -> None:
        """From now on act on what is known now, until the next call."""
        ...


@runtime_checkable
class HasReplayMemory(Protocol):
    """A learner that draws minibatches from what it remembers of episodes, its own and others'."""

    def replay_own(self, share: float) -> None:
        """From now on draw at least this share, in (0, 1], of every minibatch from episodes that it played itself; as
        long as it remembers none of them, all from all. It is called once, before anything is learned.

        Of B transitions (or segments), ⌈share · B⌉ are drawn from the own ones, as the memory draws else (uniformly
        with replacement, or by priority), and the rest from all.
        """
        ...


class StreakLimit(NamedTuple):
    """How long a host may keep a run before it reports back. It changes no result, only the number of messages.

    The episode under way is finished in any case.
    """

    episodes: int
    """Episodes per run and round, at least 1."""
    steps: int
    """Environment steps per host and round, shared by its runs."""
    nbytes: int = 2**28
    """Bytes of recorded trajectories per host and round, shared by its runs."""


class Failure(NamedTuple):
    """A run that cannot go on."""

    run: int
    """Position in the shard."""
    episode: int
    error: str
    """In a line."""
    part: Part = ""
    """What raised it."""
    place: str = ""
    """File, line and function of the user's."""
    trace: str = ""
    """The whole traceback; empty where nothing was raised."""

    @classmethod
    def of(cls, run: int, episode: int, error: BaseException) -> Failure:
        """What a user's code raised."""
        return cls(run, episode, in_a_line(error), part_of(error), place_of(error), trace_of(error))

    @classmethod
    def unbuilt(cls, run: int, error: BaseException) -> Failure:
        """What was raised before its first episode; what we say of options that are refused stands for itself."""
        failure = cls.of(run, 0, error)
        return failure._replace(error=str(error)) if isinstance(error, ValueError) else failure


class UnbuildableError(Exception):
    """Learners of some runs could not be made ready.

    Attributes
    ----------
    failures:
        Of those runs.
    learner:
        Which learner; None where it is none's.
    """

    def __init__(self, failures: Sequence[Failure], learner: int | None = None) -> None:
        super().__init__(tuple(failures), learner)
        self.failures, self.learner = tuple(failures), learner

    def __str__(self) -> str:
        """One line per distinct error."""
        return "; ".join(dict.fromkeys(failure.error for failure in self.failures))


@dataclass(frozen=True)
class Played:
    """What a bank answers after playing: a few numbers per episode, and (where others will learn) the trajectories."""

    episodes: Episodes
    batch: TrajectoryBatch | None = None
    failures: tuple[Failure, ...] = ()


class LearnerBank(Protocol):
    """The same learner for every run of a shard."""

    @property
    def is_compiled(self) -> bool:
        """Whether all that the learners compute is this project's compiled code: none of PyTorch's, nor a user's."""
        ...

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

    def skip(self, episodes: Episodes) -> tuple[Failure, ...]:
        """Take note of episodes that other learners played, and from which these learn nothing: policies are frozen
        where an epoch begins, whoever plays and learns.
        """
        ...

    @property
    def errors(self) -> Mapping[int, BaseException]:
        """What users' code raised in the last call of `state`, by run."""
        ...

    def state(self) -> State:
        """Everything needed to go on exactly here, for all runs."""
        ...

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        ...

    def models(self, runs: Sequence[int]) -> list[State]:
        """The states of the learners of some runs, each as the learner of a single run has it (`Learner.state`); empty
        for one that is among the `errors` of the call.
        """
        ...

    def begin_from(self, states: Sequence[State]) -> None:
        """Let the learners of all runs, which have just been made, begin with the states of others, as `models` gives
        them (`apel.learners.starting`).
        """
        ...
