"""The state of a shard under way, without any effect on the outside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.building import make_selector
from apel.environments import World
from apel.learners.base import Failure, Played, State
from apel.run.impossible import ImpossibleStateError
from apel.run.selection import Selector, common_blocks
from apel.run.state import (
    BAD_SELECTION,
    FAILED,
    FINISHED,
    POSITION,
    RUNNING,
    EpisodeRows,
    bad_selection_message,
    replay,
)
from cluster.events import ShardProgress
from cluster.last_tenth import LastTenth
from cluster.learner_host import open_shard_book
from cluster.protocols import RunRows
from cluster.round_log import RoundLog
from cluster.shard import Shard, recorded_episodes

CHECKPOINT_VERSION = 6
"""To be raised whenever an older checkpoint would go on to other rows."""


@dataclass
class ShardOutput:
    """What has come of a shard so far; a checkpoint holds it besides book and hosts."""

    rows: list[EpisodeRows] = field(default_factory=list)
    """Those that are not put aside yet."""
    parts: list[str] = field(default_factory=list)
    """The checksums of the files in which rows were put aside."""
    rounds: int = 0
    failures: list[tuple[Failure, int]] = field(default_factory=list)
    """With the learner in which each happened."""


class ShardState:
    """Book, rows and failures of a shard.

    Attributes
    ----------
    worlds:
        Of its runs; their environments are closed.
    """

    def __init__(self, shard: Shard, worlds: Sequence[World]) -> None:
        self.output = ShardOutput()
        self.worlds = worlds
        self._selector: Selector = make_selector(shard.arm.selector)
        self.book = open_shard_book(shard, worlds, self._selector)
        self._recorded = recorded_episodes(shard.arm.recording, shard.arm.num_episodes)
        self._num_hosts = len(shard.arm.learner_names)
        self._has_criterion = shard.arm.criterion is not None
        self._last_tenth = LastTenth.of(self.book)
        self._log = RoundLog(shard, "the coordinator")
        self._forget_recent()

    def is_running(self) -> bool:
        """Whether any run is not over."""
        return bool(np.any(self.book.status == RUNNING))

    def orders(self) -> list[list[int]]:
        """Which runs each host is to play."""
        running = self.book.status == RUNNING
        return [np.flatnonzero(running & (self.book.learner == host)).tolist() for host in range(self._num_hosts)]

    def take_in(self, answers: Sequence[Played], orders: Sequence[Sequence[int]]) -> None:
        """Replay what the hosts played; drop the runs that failed."""
        self.output.rounds += 1
        self._log.begun(dict(enumerate(orders)), self.book.episode)
        for answer in answers:
            self._last_tenth.take_in(answer.episodes, self.book.steps)
        for host, (answer, order) in enumerate(zip(answers, orders, strict=True)):
            with self._log.telling(host):
                _check_order(answer, order)
                rows = replay(self.book, self._selector, answer.episodes, self._recorded)
            if len(rows.run):
                self.output.rows.append(rows)
        self._played += [len(answer.episodes.run) for answer in answers]
        self._return += sum(float(answer.episodes.episode_return.sum()) for answer in answers)
        for host, answer in enumerate(answers):
            self.fail(answer.failures, host)
        for run in np.flatnonzero(self.book.status == BAD_SELECTION).tolist():
            self.fail([Failure(run, int(self.book.episode[run]), bad_selection_message(self.book, run))], 0)

    def fail(self, failures: Sequence[Failure], learner: int) -> None:
        """Take failed runs out of the round."""
        for failure in failures:
            if self.book.status[failure.run] != FAILED:
                self.output.failures.append((failure, learner))
                self.book.status[failure.run] = FAILED

    def num_rows(self) -> int:
        """Rows in memory."""
        return sum(len(rows.run) for rows in self.output.rows)

    def num_episodes(self) -> int:
        """Episodes played so far, over all runs."""
        return int(self.book.episode.sum())

    def progress(self, round_seconds: float, checkpoint_seconds: float) -> ShardProgress:
        """The progress to be reported; what happened since the last report is counted from here on anew."""
        over = self.book.status != RUNNING
        episodes = np.where(over, self.book.num_episodes, np.maximum(self.book.episode, self._episodes_by_steps()))
        progress = ShardProgress(
            num_finished=int(over.sum()),
            episodes=int(episodes.sum()),
            steps=int(self.book.steps.sum()),
            num_failed=int((over & (self.book.status != FINISHED)).sum()),
            train_time=int(self._train_time(self.book.num_episodes).sum()) if self._has_criterion else 0,
            rounds=self.output.rounds,
            round_seconds=round_seconds,
            checkpoint_seconds=checkpoint_seconds,
            played=tuple(self._played.tolist()),
            episode_return=self._return,
            episodes_played=self.num_episodes(),
            concentration=self._mean_concentration(),
        )
        self._forget_recent()
        return progress

    def _episodes_by_steps(self) -> NDArray[np.int64]:
        """The share of its steps that each run has played, in episodes."""
        share = self.book.steps / self.book.num_steps
        return (np.minimum(share, 1.0) * self.book.num_episodes).astype(np.int64)

    def _forget_recent(self) -> None:
        self._played = np.zeros(self._num_hosts, dtype=np.int64)
        self._return = 0.0

    def _mean_concentration(self) -> tuple[float, ...]:
        running = self.book.status == RUNNING
        block = common_blocks(self.book.selector_state[running], self._num_hosts).concentration
        return () if not len(block) or np.isnan(block).any() else tuple(block.mean(axis=0).tolist())

    def _train_time(self, cap: int = 0) -> NDArray[np.int64]:
        """Of each run that finished: when its criterion held, or how long it was played without, at least the cap."""
        done = self.book.status == FINISHED
        time = self.book.train_time[done]
        return np.where(time < 0, np.maximum(self.book.episode[done], cap), time)

    def run_rows(self) -> RunRows:
        """The rows of the runs that were finished, failed ones left out."""
        done = np.flatnonzero(self.book.status == FINISHED)
        return RunRows(
            position=done,
            train_time=self._train_time(),
            censored=self.book.train_time[done] < 0,
            episodes=self.book.episode[done],
            steps=self.book.steps[done],
            steady_state=self._steady_state()[done],
            last_tenth_return=self._last_tenth.mean(self.book)[done],
            info=tuple(self.worlds[run].info for run in done.tolist()),
        )

    def _steady_state(self) -> NDArray[np.float64]:
        episodes = self.book.num_episodes - self.book.late_from
        ended = (self.book.episode == self.book.num_episodes) & (episodes > 0)
        return np.where(ended, self.book.late_return / max(episodes, 1), np.nan)

    def checkpoint(self, states: Sequence[State]) -> dict[str, Any]:
        """Everything, as a state tree."""
        if len(self.output.rows) > 1:
            # In one piece: packing takes a while for every array, and rounds have six each.
            columns = zip(*self.output.rows, strict=True)
            self.output.rows = [EpisodeRows._make(np.concatenate(column) for column in columns)]
        return {
            "version": CHECKPOINT_VERSION,
            "hosts": list(states),
            "book": [np.array(column) for column in self.book],
            "rows": [list(rows) for rows in self.output.rows],
            "last_tenth": list(self._last_tenth),
            "parts": self.output.parts,
            "rounds": self.output.rounds,
            "failures": [[*failure, learner] for failure, learner in self.output.failures],
        }

    def restore(self, stored: dict[str, Any]) -> None:
        """Go back to what `checkpoint` returned."""
        for column, values in zip(self.book, stored["book"], strict=True):
            if isinstance(column, np.ndarray):
                column[...] = values
        for column, values in zip(self._last_tenth, stored["last_tenth"], strict=True):
            column[...] = values
        self.output = ShardOutput(
            rows=[EpisodeRows(*rows) for rows in stored["rows"]],
            parts=list(stored["parts"]),
            rounds=stored["rounds"],
            failures=[(Failure(*failure), learner) for *failure, learner in stored["failures"]],
        )


def _check_order(answer: Played, order: Sequence[int]) -> None:
    """A host plays what it was told to."""
    for run in sorted(set(answer.episodes.run.tolist()) - set(order)):
        what = "found episodes of a run that the learner's host was not told to play"
        raise ImpossibleStateError(what, {POSITION: run, "told to play": f"{len(order)} other runs"})
