"""The coordinator of a shard: runs the selectors, gives runs to hosts, broadcasts trajectories, keeps rows and
checkpoints.

A plain class that drives its hosts through the `cluster.protocols.Hosts` protocol; it is the same in this process and
on a cluster.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence

from apel.environments import World
from apel.learners.base import Failure
from cluster.checkpoint import CheckpointError, pack, unpack
from cluster.checkpoint_clock import CheckpointClock
from cluster.errors import RunFailure
from cluster.events import ShardDone, ShardProgress, ShardStopped
from cluster.learner_host import make_run_world
from cluster.play import CHECKPOINT_VERSION, Play
from cluster.protocols import CheckpointStore, Hosts, ResultSink
from cluster.shard import Execution, Shard

_MAX_ROWS_IN_MEMORY = 200_000


class Coordinator:
    """Plays shards, one after the other, with its hosts."""

    def __init__(self, hosts: Hosts, sink: ResultSink, checkpoints: CheckpointStore, execution: Execution) -> None:
        self._hosts = hosts
        self._sink = sink
        self._checkpoints = checkpoints
        self._execution = execution
        self._stopping = threading.Event()

    def stop(self) -> None:
        """After the round under way write a checkpoint and end; may be called from another thread."""
        self._stopping.set()

    def run(self, shard: Shard) -> Iterator[ShardProgress | ShardDone | ShardStopped]:
        """Play a shard to its end, from its checkpoint if there is one; yields its progress, last how it ended."""
        started = time.monotonic()
        worlds, unbuildable = _make_worlds(shard)
        broken = [failure.run for failure in unbuildable]
        whole, shard = shard, shard.without(broken)
        built = [world for world in worlds if world is not None]
        play = self._begun(shard, built) if shard.runs else Play(shard, built)
        yield from self._play_rounds(shard, play)
        if play.is_running():
            yield ShardStopped(time.monotonic() - started)
            return
        self._sink.commit(shard, play.run_rows(), play.progress.num_parts, play.progress.rows)
        self._checkpoints.delete(shard)
        failures = [_described(whole, failure, "(environment)") for failure in unbuildable]
        for failure, learner in play.progress.failures:
            failures.append(_described(shard, failure, shard.arm.learner_names[learner]))
        failures.sort(key=lambda failure: failure.run_index)
        steps = int(play.book.steps.sum())
        yield ShardDone(tuple(failures), steps, time.monotonic() - started, play.progress.rounds)

    def _begun(self, shard: Shard, worlds: Sequence[World]) -> Play:
        """The shard with its hosts ready, from its checkpoint if there is one."""
        resumed = self._resumed(shard, worlds)
        if resumed is not None:
            return resumed
        play = Play(shard, worlds)
        try:
            self._hosts.prepare(shard, self._execution, None)
        except ValueError as error:
            play.fail_all(str(error))
        return play

    def _resumed(self, shard: Shard, worlds: Sequence[World]) -> Play | None:
        """The shard as its checkpoint left it; None without one, or with one that this version cannot go on from."""
        content = self._checkpoints.read(shard)
        if content is None:
            return None
        try:
            stored = unpack(content)
            if stored["version"] != CHECKPOINT_VERSION:
                return None
            self._hosts.prepare(shard, self._execution, stored["hosts"])
            play = Play(shard, worlds)
            play.restore(stored)
        except (CheckpointError, ValueError, KeyError, TypeError):
            # It is damaged, or some learner's state has another form now: playing again costs time and no result.
            return None
        return play

    def _play_rounds(self, shard: Shard, play: Play) -> Iterator[ShardProgress]:
        """Rounds until all runs are over, or until it is to stop; then the checkpoint is written."""
        last_report = time.monotonic()
        clock = CheckpointClock(self._execution, last_report, play.num_episodes())
        round_seconds = 0.0
        while play.is_running():
            began = time.monotonic()
            orders = play.orders()
            play.take_in(self._hosts.play(orders), orders)
            if play.num_rows() > _MAX_ROWS_IN_MEMORY:
                self._sink.spill(shard, play.progress.num_parts, play.progress.rows)
                play.progress.num_parts += 1
                play.progress.rows.clear()
            now = time.monotonic()
            round_seconds += now - began
            stopping = self._stopping.is_set()
            if stopping or clock.is_due(now, play.num_episodes()):
                self._write_checkpoint(shard, play)
                clock.written(now, time.monotonic(), play.num_episodes())
            if stopping:
                return
            if now - last_report >= self._execution.progress_seconds:
                yield play.shown(round_seconds, clock.seconds)
                last_report = time.monotonic()
        yield play.shown(round_seconds, clock.seconds)

    def _write_checkpoint(self, shard: Shard, play: Play) -> None:
        states = self._hosts.states()
        for learner, (_, failures) in enumerate(states):
            play.fail(failures, learner)
        self._checkpoints.write(shard, pack(play.checkpoint([state for state, _ in states])))


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
