"""The coordinator of a shard: runs the selectors, gives runs to hosts, broadcasts trajectories, keeps rows and
checkpoints.

A plain class that drives its hosts through the `cluster.protocols.Hosts` protocol; it is the same in this process and
on a cluster.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence

from apel.environments import World, alike, close_environments
from apel.learners.base import Failure, UnbuildableError
from apel.run.user_code import faults_of
from cluster.checkpoint import CheckpointError, pack, seal, unpack, unseal
from cluster.checkpoint_clock import CheckpointClock
from cluster.errors import RunFailure
from cluster.events import ShardDone, ShardProgress, ShardReplayed, ShardStopped
from cluster.learner_host import make_run_world
from cluster.models import ModelClock, agents_of, finished
from cluster.parts import Parts, Told, in_order
from cluster.protocols import NO_RUN_ROWS, CheckpointStore, Hosts, ResultSink
from cluster.shard import Execution, Shard
from cluster.shard_state import CHECKPOINT_VERSION, ShardState

_MAX_ROWS_IN_MEMORY = 200_000
# What the restoring of a state of another form may raise, a user's learner's included. A host that is lost raises none.
_FORM_ERRORS = (
    UnbuildableError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RuntimeError, AssertionError,
)  # fmt: skip


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

    def close(self) -> None:
        """Close the environments, whatever is under way: the end is near. May be called from another thread."""
        self._hosts.close()

    def run(self, shard: Shard) -> Iterator[Told]:
        """Play a shard to its end, from its checkpoint if there is one; yields its progress, last how it ended.

        Runs whose environments differ in shape cannot be played side by side: they are played kind by kind, each as if
        it were a shard by itself.
        """
        try:
            yield from self._run(shard, time.monotonic())
        finally:
            self._hosts.close()

    def _run(self, whole: Shard, started: float) -> Iterator[Told]:
        shard, worlds, failures = _make_worlds(whole)
        parts = alike(worlds)
        if len(parts) <= 1:
            yield from self._run_alike(shard, worlds, failures, started)
            return
        total = Parts(failures)
        for positions in parts:
            part = shard.only(positions), [worlds[i] for i in positions]
            yield from total.told(self._run_alike(*part, [], started))
            if total.is_stopped:
                return
        yield total.done()

    def _run_alike(
        self, whole: Shard, its_worlds: Sequence[World], failed: Sequence[RunFailure], started: float
    ) -> Iterator[Told]:
        """Play runs that can be played side by side; ``failed`` are those of the shard that cannot be played."""
        shard, worlds, failures = whole, list(its_worlds), [*failed]
        state = refused = None
        while shard.runs and state is None:
            try:
                state, refused = self._begun(shard, worlds)
            except UnbuildableError as error:
                failures += _all_described(shard, error.failures, error.learner)
                broken = {failure.run for failure in error.failures}
                worlds = [world for run, world in enumerate(worlds) if run not in broken]
                shard = shard.without(sorted(broken))
        if state is None:
            self._sink.commit(shard, NO_RUN_ROWS, [], [])
            yield ShardDone(in_order(failures), 0, time.monotonic() - started, 0)
            return
        if refused:
            yield ShardReplayed(f"its checkpoint does not fit: {refused}")
        yield from self._play_rounds(shard, state)
        if state.is_running():
            yield ShardStopped(time.monotonic() - started)
            return
        self._end(shard, state)
        try:
            self._sink.commit(shard, state.run_rows(), state.output.parts, state.output.rows)
        except CheckpointError as error:
            self._checkpoints.delete(shard)
            yield ShardReplayed(f"episodes that were put aside do not fit: {error}")
            yield from self._run_alike(whole, its_worlds, failed, started)
            return
        self._checkpoints.delete(shard)
        for failure, learner in state.output.failures:
            failures += _all_described(shard, [failure], learner)
        steps = int(state.book.steps.sum())
        seconds = time.monotonic() - started
        yield ShardDone(in_order(failures), steps, seconds, state.output.rounds, state.num_episodes())

    def _begun(self, shard: Shard, worlds: Sequence[World]) -> tuple[ShardState, str | None]:
        """The shard with its hosts ready, from its checkpoint if there is one that fits; else why it does not.

        Raises
        ------
        UnbuildableError
            If some runs cannot be begun.
        """
        refused = None
        try:
            resumed = self._resumed(shard, worlds)
            if resumed is not None:
                return resumed, None
        except CheckpointError as error:
            refused = str(error)
        state = _new_state(shard, worlds)
        self._hosts.prepare(shard, self._execution, None)
        return state, refused

    def _resumed(self, shard: Shard, worlds: Sequence[World]) -> ShardState | None:
        """The shard as its checkpoint left it; None without one.

        Raises
        ------
        CheckpointError
            If it is damaged, another shard's, or of another form than this version's: playing again costs time, and no
            result.
        UnbuildableError
            If some runs cannot be begun.
        """
        content = self._checkpoints.read(shard)
        if content is None:
            return None
        stored = unpack(unseal(content, _label(shard)))
        state = _new_state(shard, worlds)
        try:
            self._hosts.prepare(shard, self._execution, stored["hosts"])
            state.restore(stored)
        except _FORM_ERRORS as error:
            message = (
                f"found a state of another form ({type(error).__name__}: {error}), expected one that can be restored"
            )
            raise CheckpointError(message) from error
        return state

    def _play_rounds(self, shard: Shard, state: ShardState) -> Iterator[ShardProgress]:
        """Rounds until all runs are over, or until it is to stop; then the checkpoint is written."""
        last_report = time.monotonic()
        clock = CheckpointClock(self._execution, last_report, state.num_episodes())
        round_seconds, models = 0.0, ModelClock(state.book)
        while state.is_running():
            began = time.monotonic()
            orders = state.orders()
            state.take_in(self._hosts.play(orders), orders)
            if due := models.due(state.book):
                self._keep_models(shard, state, due)
            if state.num_rows() > _MAX_ROWS_IN_MEMORY:
                part = self._sink.spill(shard, len(state.output.parts), state.output.rows)
                state.output.parts.append(part)
                state.output.rows.clear()
            now = time.monotonic()
            round_seconds += now - began
            stopping = self._stopping.is_set()
            if stopping or clock.is_due(now, state.num_episodes()):
                self._write_checkpoint(shard, state)
                clock.written(now, time.monotonic(), state.num_episodes())
            if stopping:
                return
            if state.is_running() and now - last_report >= self._execution.progress_seconds:
                yield state.progress(round_seconds, clock.seconds)
                last_report = time.monotonic()
        yield state.progress(round_seconds, clock.seconds)

    def _end(self, shard: Shard, state: ShardState) -> None:
        """What is left to do when all runs are over."""
        # A learner that fails at the last episode of a run fails it, whatever is played beside it, and for how long.
        for learner, failures in enumerate(self._hosts.catch_up()):
            state.fail(failures, learner)
        if shard.arm.models != "none":
            self._keep_models(shard, state, finished(state.book))

    def _keep_models(self, shard: Shard, state: ShardState, due: Sequence[tuple[int, str]]) -> None:
        """Store the models of some runs at their marks; a run whose learners cannot say what they are fails."""
        runs, marks = [run for run, _ in due], dict(due)
        answers = self._hosts.models(runs) if runs else []
        for learner, (_, failures) in enumerate(answers):
            state.fail(failures, learner)
        for run, model in agents_of(shard, state.worlds, state.book, runs, [states for states, _ in answers]):
            try:
                self._sink.keep(shard, run, marks[run], model)
            except CheckpointError as error:
                state.fail([Failure(run, int(state.book.episode[run]), str(error))], 0)

    def _write_checkpoint(self, shard: Shard, state: ShardState) -> None:
        host_states = self._hosts.states()
        for learner, (_, failures) in enumerate(host_states):
            state.fail(failures, learner)
        content = pack(state.checkpoint([host_state for host_state, _ in host_states]))
        self._checkpoints.write(shard, seal(content, _label(shard)))


def _label(shard: Shard) -> dict[str, str]:
    return {**shard.binding, "format": str(CHECKPOINT_VERSION)}


def _make_worlds(shard: Shard) -> tuple[Shard, list[World], list[RunFailure]]:
    """The runs whose environments can be made, and what these have told; the others fail alone.

    The environments are closed: they are played where the learners are.
    """
    worlds, failures = list[World](), list[Failure]()
    for position, run in enumerate(shard.runs):
        try:
            with faults_of("environment"):
                worlds.append(make_run_world(run))
        except Exception as error:  # noqa: BLE001 - whatever a user's code raises ends this run, and only this one
            failures.append(Failure.of(position, 0, error))
        else:
            close_environments([worlds[-1].environment])
    described = _all_described(shard, failures, None, "(environment)")
    return shard.without([failure.run for failure in failures]), worlds, described


def _new_state(shard: Shard, worlds: Sequence[World]) -> ShardState:
    """The shard before its first episode, for which the selector chooses."""
    try:
        with faults_of("selector"):
            return ShardState(shard, worlds)
    except Exception as error:
        failures = [Failure.unbuilt(run, error) for run in range(len(shard.runs))]
        raise UnbuildableError(failures) from error


def _all_described(
    shard: Shard, failures: Sequence[Failure], learner: int | None, otherwise: str = "(selector)"
) -> list[RunFailure]:
    """Failures with the names that people know."""
    arm, name = shard.arm, otherwise if learner is None else shard.arm.learner_names[learner]
    described = []
    for run, episode, error, part, place, trace in failures:
        plan = shard.runs[run]
        about = (arm.arm, arm.sweep, plan.index, plan.seed, name)
        described.append(RunFailure(*about, episode, error, part, place, trace))
    return described
