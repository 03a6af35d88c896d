"""The coordinator of a shard: runs the selectors, gives runs to hosts, broadcasts trajectories, keeps rows and
checkpoints.

A plain class that drives its hosts through the `Hosts` protocol; it is the same in this process and on a cluster.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from apel.book import BAD_SELECTION, FAILED, FINISHED, RUNNING, EpisodeRows, bad_selection_message, replay
from apel.building import make_selector
from apel.environments import World
from apel.learners.base import Failure, Played, State
from apel.selection import Selector
from cluster.checkpoint import CheckpointError, pack, unpack
from cluster.errors import RunFailure
from cluster.learner_host import make_run_world, open_shard_book
from cluster.shard import Execution, Shard, recorded_episodes

_MAX_ROWS_IN_MEMORY = 200_000
_CHECKPOINT_VERSION = 2
"""To be raised whenever an older checkpoint would go on to other rows."""


@dataclass(frozen=True)
class ShardProgress:
    """How far a shard has come."""

    num_finished: int
    """Runs that are over, failed ones included."""
    episodes: int
    """Episodes played, over all runs; a run that is over counts with its cap."""
    steps: int


@dataclass(frozen=True)
class ShardDone:
    """A shard is over and its results are stored."""

    failures: tuple[RunFailure, ...]
    steps: int
    seconds: float
    rounds: int


@dataclass(frozen=True)
class RunRows:
    """One row per finished run of a shard."""

    position: NDArray[np.int64]
    """Which run of the shard."""
    train_time: NDArray[np.int64]
    """Episodes until the criterion held; the number of episodes played where it never did."""
    censored: NDArray[np.bool_]
    """The criterion never held."""
    episodes: NDArray[np.int64]
    steps: NDArray[np.int64]
    steady_state: NDArray[np.float64]
    """Mean return of the last episodes before the cap; NaN where nobody asked for it, or the run ended before."""
    info: tuple[dict[str, float], ...]


class Hosts(Protocol):
    """The learner hosts of a shard, wherever they are."""

    def prepare(self, shard: Shard, execution: Execution, states: Sequence[State] | None) -> None:
        """Make host i ready for learner i of the shard."""
        ...

    def play(self, orders: Sequence[Sequence[int]]) -> list[Played]:
        """One round: host i learns from what the others played last, then plays the runs ``orders[i]``."""
        ...

    def states(self) -> list[tuple[State, tuple[Failure, ...]]]:
        """The states of all hosts, after they have learned from what the others played last, and where that failed."""
        ...


class ResultSink(Protocol):
    """Where a shard's rows go. Nothing is seen before `commit`."""

    def spill(self, shard: Shard, part: int, rows: Sequence[EpisodeRows]) -> None:
        """Put rows aside, in a place that is overwritten if the part is written again."""
        ...

    def commit(self, shard: Shard, runs: RunRows, num_parts: int, rows: Sequence[EpisodeRows]) -> None:
        """Store the rows of the finished runs: those put aside, then ``rows``."""
        ...


class CheckpointStore(Protocol):
    """Where a shard's checkpoint lies: at most one, replaced as a whole."""

    def read(self, shard: Shard) -> bytes | None:
        """The last checkpoint, or None."""
        ...

    def write(self, shard: Shard, content: bytes) -> None:
        """Replace it."""
        ...

    def delete(self, shard: Shard) -> None:
        """Forget it."""
        ...


@dataclass
class _Progress:
    """What a checkpoint holds besides book and hosts."""

    rows: list[EpisodeRows] = field(default_factory=list)
    num_parts: int = 0
    rounds: int = 0
    failures: list[tuple[Failure, int]] = field(default_factory=list)
    """With the learner in which each happened."""


class Coordinator:
    """Plays shards, one after the other, with its hosts."""

    def __init__(self, hosts: Hosts, sink: ResultSink, checkpoints: CheckpointStore, execution: Execution) -> None:
        self._hosts = hosts
        self._sink = sink
        self._checkpoints = checkpoints
        self._execution = execution

    def run(self, shard: Shard) -> Iterator[ShardProgress | ShardDone]:
        """Play a shard to its end, from its checkpoint if there is one; yields its progress, last that it is done."""
        started = time.monotonic()
        worlds, unbuildable = _make_worlds(shard)
        broken = [failure.run for failure in unbuildable]
        whole, shard = shard, shard.without(broken)
        built = [world for world in worlds if world is not None]
        play = self._begun(shard, built) if shard.runs else _Play(shard, built)
        yield from self._play_rounds(shard, play)
        self._sink.commit(shard, play.run_rows(), play.progress.num_parts, play.progress.rows)
        self._checkpoints.delete(shard)
        failures = [_described(whole, failure, "(environment)") for failure in unbuildable]
        for failure, learner in play.progress.failures:
            failures.append(_described(shard, failure, shard.arm.learner_names[learner]))
        failures.sort(key=lambda failure: failure.run_index)
        steps = int(play.book.steps.sum())
        yield ShardDone(tuple(failures), steps, time.monotonic() - started, play.progress.rounds)

    def _begun(self, shard: Shard, worlds: Sequence[World]) -> _Play:
        """The shard with its hosts ready, from its checkpoint if there is one."""
        resumed = self._resumed(shard, worlds)
        if resumed is not None:
            return resumed
        play = _Play(shard, worlds)
        try:
            self._hosts.prepare(shard, self._execution, None)
        except ValueError as error:
            play.fail_all(str(error))
        return play

    def _resumed(self, shard: Shard, worlds: Sequence[World]) -> _Play | None:
        """The shard as its checkpoint left it; None without one, or with one that this version cannot go on from."""
        content = self._checkpoints.read(shard)
        if content is None:
            return None
        try:
            stored = unpack(content)
            if stored["version"] != _CHECKPOINT_VERSION:
                return None
            self._hosts.prepare(shard, self._execution, stored["hosts"])
            play = _Play(shard, worlds)
            play.restore(stored)
        except (CheckpointError, ValueError, KeyError, TypeError):
            # It is damaged, or some learner's state has another form now: playing again costs time and no result.
            return None
        return play

    def _play_rounds(self, shard: Shard, play: _Play) -> Iterator[ShardProgress]:
        last_checkpoint = last_progress = time.monotonic()
        while play.is_running():
            orders = play.orders()
            play.take_in(self._hosts.play(orders), orders)
            if play.num_rows() > _MAX_ROWS_IN_MEMORY:
                self._sink.spill(shard, play.progress.num_parts, play.progress.rows)
                play.progress.num_parts += 1
                play.progress.rows.clear()
            now = time.monotonic()
            if now - last_checkpoint >= self._execution.checkpoint_seconds:
                states = self._hosts.states()
                for learner, (_, failures) in enumerate(states):
                    play.fail(failures, learner)
                self._checkpoints.write(shard, pack(play.checkpoint([state for state, _ in states])))
                last_checkpoint = time.monotonic()
            if now - last_progress >= self._execution.progress_seconds:
                yield play.shown()
                last_progress = now


class _Play:
    """The state of a shard under way, without any effect on the outside."""

    def __init__(self, shard: Shard, worlds: Sequence[World]) -> None:
        self.progress = _Progress()
        self._worlds = worlds
        self._selector: Selector = make_selector(shard.arm.selector)
        self.book = open_shard_book(shard, worlds, self._selector)
        self._recorded = recorded_episodes(shard.arm.recording, shard.arm.num_episodes)
        self._num_hosts = len(shard.arm.learner_names)
        self._num_runs = len(shard.runs)

    def is_running(self) -> bool:
        return bool(np.any(self.book.status == RUNNING))

    def orders(self) -> list[list[int]]:
        """Which runs each host is to play."""
        running = self.book.status == RUNNING
        return [np.flatnonzero(running & (self.book.learner == host)).tolist() for host in range(self._num_hosts)]

    def take_in(self, answers: Sequence[Played], orders: Sequence[Sequence[int]]) -> None:
        """Replay what the hosts played; drop the runs that failed."""
        self.progress.rounds += 1
        for answer, order in zip(answers, orders, strict=True):
            assert set(answer.episodes.run.tolist()) <= set(order)  # noqa: S101 - a host plays what it was told to
            rows = replay(self.book, self._selector, answer.episodes, self._recorded)
            if len(rows.run):
                self.progress.rows.append(rows)
        for host, answer in enumerate(answers):
            self.fail(answer.failures, host)
        for run in np.flatnonzero(self.book.status == BAD_SELECTION).tolist():
            self.fail([Failure(run, int(self.book.episode[run]), bad_selection_message(self.book, run))], 0)

    def fail(self, failures: Sequence[Failure], learner: int) -> None:
        """Take failed runs out of the round."""
        for failure in failures:
            if self.book.status[failure.run] != FAILED:
                self.progress.failures.append((failure, learner))
                self.book.status[failure.run] = FAILED

    def fail_all(self, error: str) -> None:
        """The shard's learners could not even be built."""
        self.fail([Failure(run, 0, error) for run in range(self._num_runs)], 0)

    def num_rows(self) -> int:
        return sum(len(rows.run) for rows in self.progress.rows)

    def shown(self) -> ShardProgress:
        over = self.book.status != RUNNING
        episodes = np.where(over, self.book.num_episodes, self.book.episode)
        return ShardProgress(int(over.sum()), int(episodes.sum()), int(self.book.steps.sum()))

    def run_rows(self) -> RunRows:
        """The rows of the runs that were finished, failed ones left out."""
        done = np.flatnonzero(self.book.status == FINISHED)
        time = self.book.train_time[done]
        return RunRows(
            position=done,
            train_time=np.where(time < 0, self.book.episode[done], time),
            censored=time < 0,
            episodes=self.book.episode[done],
            steps=self.book.steps[done],
            steady_state=self._steady_state()[done],
            info=tuple(self._worlds[run].info for run in done.tolist()),
        )

    def _steady_state(self) -> NDArray[np.float64]:
        episodes = self.book.num_episodes - self.book.late_from
        ended = (self.book.episode == self.book.num_episodes) & (episodes > 0)
        return np.where(ended, self.book.late_return / max(episodes, 1), np.nan)

    def checkpoint(self, states: Sequence[State]) -> dict[str, Any]:
        """Everything, as a state tree."""
        if len(self.progress.rows) > 1:
            # In one piece: packing takes a while for every array, and rounds have six each.
            columns = zip(*self.progress.rows, strict=True)
            self.progress.rows = [EpisodeRows._make(np.concatenate(column) for column in columns)]
        return {
            "version": _CHECKPOINT_VERSION,
            "hosts": list(states),
            "book": [np.array(column) for column in self.book],
            "rows": [list(rows) for rows in self.progress.rows],
            "num_parts": self.progress.num_parts,
            "rounds": self.progress.rounds,
            "failures": [[*failure, learner] for failure, learner in self.progress.failures],
        }

    def restore(self, stored: dict[str, Any]) -> None:
        """Go back to what `checkpoint` returned."""
        for column, values in zip(self.book, stored["book"], strict=True):
            if isinstance(column, np.ndarray):
                column[...] = values
        self.progress = _Progress(
            rows=[EpisodeRows(*rows) for rows in stored["rows"]],
            num_parts=stored["num_parts"],
            rounds=stored["rounds"],
            failures=[(Failure(*failure), learner) for *failure, learner in stored["failures"]],
        )


def _make_worlds(shard: Shard) -> tuple[list[World | None], list[Failure]]:
    """The environment of each run; a run whose environment cannot be made fails alone."""
    worlds: list[World | None] = []
    failures = []
    for position, run in enumerate(shard.runs):
        try:
            worlds.append(make_run_world(run))
        except Exception as error:  # noqa: BLE001 - whatever a user's code raises ends this run, and only this one
            worlds.append(None)
            failures.append(Failure(position, 0, f"{type(error).__name__}: {error}"))
    return worlds, failures


def _described(shard: Shard, failure: Failure, learner: str) -> RunFailure:
    """A failure with the names that people know."""
    run = shard.runs[failure.run]
    return RunFailure(shard.arm.arm, shard.arm.sweep, run.index, run.seed, learner, failure.episode, failure.error)
