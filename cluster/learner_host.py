"""One base learner of a shard: its models for every run, and a copy of the shard's book."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from apel.building import is_tabular, make_bank, make_performance, make_selector, make_world
from apel.environments import World, close_environments
from apel.experience.trajectory import Episodes, TrajectoryBatch
from apel.learners.base import Failure, LearnerBank, Played, State, StreakLimit, UnbuildableError
from apel.numerics import rounding, threads
from apel.run.impossible import ImpossibleStateError
from apel.run.opening import open_book
from apel.run.selection import Selector, freezes_policies
from apel.run.state import POSITION, RUNNING, STATUS_NAMES, Book, replay
from apel.run.user_code import faults_of
from cluster.checkpoint import writable
from cluster.round_log import RoundLog
from cluster.shard import Execution, RunPlan, Shard

_SOLO_STREAK_SCALE = 10
_FIRST_ROUND_STEPS, _MAX_GROWTH = 5_000, 8
_NO_EPISODES = Episodes.empty(0)


def make_run_world(run: RunPlan) -> World:
    """The environment of a run."""
    rounding.settle()  # before anything of a user's is loaded, which may bring PyTorch
    return make_world(run.environment, run.seed)


def open_shard_book(shard: Shard, worlds: Sequence[World], selector: Selector) -> Book:
    """The book of a shard before its first episode."""
    return open_book(
        selector,
        len(shard.arm.learner_names),
        shard.arm.num_episodes,
        shard.arm.criterion,
        [run.seed for run in shard.runs],
        [world.info for world in worlds],
        run_variables=[run.variables for run in shard.runs],
        num_steps=shard.arm.num_steps,
        stops_when_met=shard.arm.stops_when_met,
        steady_state_episodes=shard.arm.steady_state_episodes,
        acting_floor=shard.arm.selector.acting_floor,
        pause_every=shard.pause_every,
    )


def paced_steps(limit: int, steps: int, seconds: float, wanted_seconds: float, most: int) -> int:
    """The limit for the next round, after one of ``steps`` took ``seconds``: as many steps as last ``wanted_seconds``,
    at most ``most``, and not many times the last ``limit``.

    >>> paced_steps(5_000, 5_000, 0.5, 2.0, 1_000_000), paced_steps(5_000, 300, 0.001, 2.0, 1_000_000)
    (20000, 40000)
    """
    # A short round says little of how fast a learner is: most of it may be the call.
    fitting = steps * wanted_seconds / seconds if seconds > wanted_seconds / 10 else most
    return int(max(min(fitting, limit * _MAX_GROWTH, most), 1))


class LearnerHost:
    """Plays and learns with one base learner, for all runs of a shard. A plain class: `cluster.launch` makes it an
    actor.

    The host keeps its own copy of the book. While it plays a streak the book says how long the streak lasts; the
    episodes that other hosts played it learns from, and takes into its book, at the beginning of the next round. The
    delay changes nothing: before it acts in a run again it has learned from everything that happened there.

    Parameters
    ----------
    records:
        Answer with trajectories also where there is no other learner that needs them.
    """

    def __init__(self, *, records: bool = False) -> None:
        self._records = records
        self._worlds: list[World] = []
        self._bank: LearnerBank
        self._book: Book
        self._selector: Selector
        self._index = 0
        self._limit = StreakLimit(1, 1)
        self._most_steps, self._round_seconds = 1, 0.0
        self._record, self._learns = False, True
        self._nothing = np.zeros(0, dtype=np.bool_)
        self._log: RoundLog

    def prepare(self, shard: Shard, index: int, execution: Execution, state: State | None) -> None:
        """Build learner ``index`` of the shard; go on from ``state`` if there is one.

        Raises
        ------
        UnbuildableError
            If something cannot be built.
        RoundingError
            If what it computes could depend on the learners beside it, see `apel.numerics.rounding`.
        """
        self.close()
        try:
            with faults_of(""):
                self._prepare(shard, index, execution, state)
        except (UnbuildableError, rounding.RoundingError, ImpossibleStateError):
            raise
        except Exception as error:
            failures = [Failure.unbuilt(run, error) for run in range(len(shard.runs))]
            raise UnbuildableError(failures, index) from error

    def close(self) -> None:
        """Close the environments."""
        close_environments(world.environment for world in self._worlds)
        self._worlds = []

    def _prepare(self, shard: Shard, index: int, execution: Execution, state: State | None) -> None:
        for run in shard.runs:
            self._worlds.append(make_run_world(run))
        worlds = self._worlds
        columns = list(zip(*(run.learners for run in shard.runs), strict=True))
        others = [column for i, column in enumerate(columns) if i != index]
        self._learns = columns[index][0].learns_from != "own"
        self._selector = make_selector(shard.arm.selector)
        self._book = open_shard_book(shard, worlds, self._selector)
        criterion = shard.arm.criterion
        self._bank = make_bank(
            columns[index],
            worlds,
            [run.seed for run in shard.runs],
            index,
            make_performance(shard.arm.performance),
            with_probability=any(not is_tabular(column, worlds) for column in others if column[0].learns_from != "own"),
            freezes=freezes_policies(self._selector),
            evaluates=criterion is not None and criterion.evaluation == "greedy",
            raises=execution.raises,
        )
        if not self._bank.is_compiled:
            rounding.refuse_if_too_late()
            threads.settle()  # of a user's learner, who need not know of it
        self._index = index
        self._log = RoundLog(shard, f"the host of {shard.arm.learner_names[index]}")
        self._record = self._records or bool(others)
        # A learner alone sends no trajectories, only a few numbers per episode: its messages can be rarer.
        scale = 1 if self._record else _SOLO_STREAK_SCALE
        self._most_steps, self._round_seconds = scale * execution.streak_steps, execution.round_seconds
        self._limit = StreakLimit(scale * execution.streak_episodes, min(_FIRST_ROUND_STEPS, self._most_steps))
        self._nothing = np.zeros(shard.arm.num_episodes, dtype=np.bool_)
        if state is not None:
            self._bank.restore(writable(state["bank"]))
            for column, stored in zip(self._book, state["book"], strict=True):
                if isinstance(column, np.ndarray):
                    column[...] = stored

    def play(self, runs: Sequence[int], *batches: TrajectoryBatch) -> tuple[Played, TrajectoryBatch | None]:
        """One round: learn from the others' last batches, then play a streak of each of ``runs``.

        Answers with the small part and, apart from it, the trajectories for the others.
        """
        failures = self._catch_up(batches)
        self._log.begun({self._index: runs}, self._book.episode)
        failed = {failure.run for failure in failures}
        playable = [run for run in runs if run not in failed]
        if not playable:
            return Played(_NO_EPISODES, None, failures), None
        self._check_turns(playable)
        began = time.monotonic()
        played = self._bank.play(playable, self._book, self._selector, self._index, self._limit, record=self._record)
        steps, seconds = int(played.episodes.length.sum()), time.monotonic() - began
        allowed = paced_steps(self._limit.steps, steps, seconds, self._round_seconds, self._most_steps)
        self._limit = self._limit._replace(steps=allowed)
        return replace(played, batch=None, failures=(*failures, *played.failures)), played.batch

    def catch_up(self, *batches: TrajectoryBatch) -> tuple[Failure, ...]:
        """Learn from the others' last batches, and say where that failed: runs that are over have no round to come."""
        return self._catch_up(batches)

    def state(self, *batches: TrajectoryBatch) -> tuple[State, tuple[Failure, ...]]:
        """Everything needed to go on, after learning from the others' last batches.

        A run that is over does not go on: that its learner cannot say what it is by now fails nothing.
        """
        failures = self._catch_up(batches)
        state, episodes, status = self._bank.state(), self._book.episode, self._book.status
        broken = [(run, error) for run, error in self._bank.errors.items() if status[run] == RUNNING]
        errors = [Failure.of(run, int(episodes[run]), error) for run, error in broken]
        return {"bank": state, "book": [np.array(column) for column in self._book]}, (*failures, *errors)

    def models(self, runs: Sequence[int], *batches: TrajectoryBatch) -> tuple[list[State], tuple[Failure, ...]]:
        """The learners of ``runs`` as those of single runs (`LearnerBank.models`), after learning from the others' last
        batches.
        """
        failures, episodes = self._catch_up(batches), self._book.episode
        states = self._bank.models(runs)
        errors = [Failure.of(run, int(episodes[run]), error) for run, error in self._bank.errors.items()]
        return states, (*failures, *errors)

    def _check_turns(self, runs: Sequence[int]) -> None:
        """The coordinator asks for runs whose turn it is, by the same book; else the round would never end."""
        book = self._book
        wrong = (book.learner[runs] != self._index) | (book.status[runs] != RUNNING)
        for position in np.flatnonzero(wrong)[:1].tolist():
            run = runs[position]
            facts: dict[str, int | str] = {
                POSITION: run,
                "episode": int(book.episode[run]),
                "selected learner": int(book.learner[run]),
                "status": STATUS_NAMES[book.status[run]],
            }
            with self._log.telling(self._index):
                what = "a learner's host was told to play a run that is not its own by its own book"
                raise ImpossibleStateError(what, facts)

    def _catch_up(self, batches: Sequence[TrajectoryBatch]) -> tuple[Failure, ...]:
        failures: list[Failure] = []
        for batch in batches:
            failures += self._bank.learn(batch) if self._learns else self._bank.skip(batch.episodes)
        if batches:
            # In one call: a run is played by one host per round, so that the order of the batches does not matter.
            columns = zip(*(batch.episodes for batch in batches), strict=True)
            with self._log.telling():
                replay(self._book, self._selector, Episodes._make(map(np.concatenate, columns)), self._nothing)
        return tuple(failures)
