"""Who plays which shard, and when: the decisions of a pool, without any effect.

`PoolState.handle` takes in one event and answers with instructions (`cluster.pool_events`); `cluster.pool` asks Ray for
the one and carries out the other. Neither a clock nor Ray is known here: time comes in as a number, and a test of a
whole job takes a millisecond. After dask's ``distributed/worker_state_machine.py``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from apel.run.impossible import ImpossibleStateError
from cluster import pool_events as told
from cluster.errors import ClusterError, ShardLostError
from cluster.events import ShardDone, ShardProgress, ShardRestarted, ShardStopped, ShardWaiting
from cluster.pool_events import Gpus, Instruction, PoolEvent
from cluster.pool_story import PoolStory
from cluster.retry import FaultCounter, RetryPolicy
from cluster.shard import Shard

POLL_SECONDS = 0.5
"""The longest wait for a gang: shards whose back-off is over, CPUs that join and a wish to stop are seen after it."""


def gangs_to_hire(num_cpus: int, num_gangs: int, num_idle: int, num_waiting: int) -> int:
    """How many gangs to start, or, where negative, how many idle ones to dismiss.

    One per CPU while shards wait. Idle ones go when nothing waits, since others may want their CPUs, and when nodes
    have left: a gang that was never placed would otherwise wait for the CPU of one that is done.

    >>> gangs_to_hire(num_cpus=4, num_gangs=1, num_idle=0, num_waiting=2)
    2
    >>> gangs_to_hire(num_cpus=2, num_gangs=4, num_idle=1, num_waiting=5), gangs_to_hire(4, 4, 3, 0)
    (-1, -3)
    """
    if num_waiting == 0:
        return -num_idle
    if num_gangs > num_cpus:
        return -min(num_idle, num_gangs - num_cpus)
    return min(num_cpus - num_gangs, max(num_waiting - num_idle, 0))


@dataclass(frozen=True, slots=True)
class _Gang:
    number: int
    gpus: Gpus


@dataclass(frozen=True, slots=True)
class _Delayed:
    """A shard that begins again after its back-off."""

    ready_at: float
    shard: Shard


@dataclass(slots=True)
class _Playing:
    """A gang and its shard."""

    gang: _Gang
    shard: Shard
    has_ended: bool = False
    """Whether the gang has said how the shard ended."""


class PoolState:
    """The gangs of a job, and the shards that they play.

    A shard waits in the queue, waits out its back-off, is played by one gang, or is over. A gang is idle or plays.
    """

    def __init__(self, retry: RetryPolicy | None = None) -> None:
        self._faults = FaultCounter(retry or RetryPolicy())
        self._shards: frozenset[tuple[str, str, int]] = frozenset()
        #: Keys of the shards that are done, that ended with a checkpoint, that a stop forgot, or that were given up.
        self._over: set[tuple[str, str, int]] = set()
        self._queue: deque[Shard] = deque()
        self._delayed: list[_Delayed] = []
        self._idle: list[_Gang] = []
        #: By the number of its gang, in the order in which they were started.
        self._playing: dict[int, _Playing] = {}
        self._num_hired = 0
        #: None before the first count.
        self._num_cpus: int | None = None
        self._has_begun = self._has_given_up = self._was_starved = False
        self.is_stopping = False
        self._now = -math.inf
        self._story = PoolStory()

    @property
    def is_over(self) -> bool:
        """Whether no shard waits, and none is played."""
        return not (self._queue or self._delayed or self._playing)

    @property
    def num_restarts(self) -> int:
        """How many times a shard had to begin again."""
        return self._faults.total

    def handle(self, event: PoolEvent, now: float) -> list[Instruction]:
        """Take in what happened; what is to be done, in this order.

        ``now`` is in seconds of a monotonic clock.

        Raises
        ------
        ImpossibleStateError
            If it cannot have happened; the message tells what came before.
        """
        if self._has_begun == isinstance(event, told.JobBegun) or self._has_given_up:
            raise self._impossible(event, "found an event before the job's beginning, or after its end")
        if now < self._now:
            raise self._impossible(event, "found a clock that goes back")
        self._now = now
        instructions = list(self._answer(event, now))
        self._story.add(now, event, instructions)
        return instructions

    def _answer(self, event: PoolEvent, now: float) -> Iterable[Instruction]:
        match event:
            case told.JobBegun():
                return self._handle_job_begun(event)
            case told.CpusCounted():
                self._num_cpus = event.num_cpus
                return ()
            case told.Tick():
                return self._handle_tick(event, now)
            case told.StopAsked():
                return self._handle_stop_asked(event)
            case told.GangReported():
                return self._handle_gang_reported(event)
            case told.GangFreed():
                return self._handle_gang_freed(event)
            case told.GangLost():
                return self._handle_gang_lost(event, now)
            case told.GangFailed():
                return self._handle_gang_failed(event)

    def _handle_job_begun(self, event: told.JobBegun) -> Iterator[Instruction]:
        self._has_begun = True
        self._queue = deque(event.shards)
        self._shards = frozenset(shard.key for shard in event.shards)
        if len(self._shards) < len(event.shards):
            raise self._impossible(event, "found two shards with one key")
        wanted = max((sum(shard.arm.learner_gpus) for shard in event.shards), default=0.0)
        if wanted > event.num_gpus:  # a gang would wait for ever
            message = (
                f"found {event.num_gpus:g} GPUs in the Ray cluster, expected at least {wanted:g}: the num_gpus of an "
                "arm's learners"
            )
            yield self._give_up(ClusterError(message))

    def _handle_tick(self, event: told.Tick, now: float) -> Iterator[Instruction]:
        if self._num_cpus is None:
            raise self._impossible(event, "found shards to begin before CPUs were counted")
        self._queue_due(now)
        yield from self._balance(self._num_cpus)
        yield from self._begin_shards()
        is_starved = bool(self._queue) and self._num_cpus == 0
        if is_starved and not self._was_starved:
            yield told.Report(self._queue[0], ShardWaiting())
        self._was_starved = is_starved
        yield told.Wait(tuple(self._playing), POLL_SECONDS)

    def _handle_stop_asked(self, event: told.StopAsked) -> Iterator[Instruction]:
        """Begin nothing more; what is under way ends with a checkpoint."""
        if self.is_stopping or not event.placed <= self._playing.keys():
            raise self._impossible(event, "found a second wish to stop, or one for gangs that do not play")
        self.is_stopping = True
        self._over |= {shard.key for shard in (*self._queue, *(one.shard for one in self._delayed))}
        self._queue.clear()
        self._delayed.clear()
        for gang in list(self._playing):
            if gang in event.placed:
                yield told.AskToStop(gang)
            else:  # it has no process that could hear it, and may never have one
                self._over.add(self._playing.pop(gang).shard.key)
                yield told.Dismiss(gang)

    def _handle_gang_reported(self, event: told.GangReported) -> Iterator[Instruction]:
        playing = self._player(event, event.gang)
        if playing.has_ended:
            raise self._impossible(event, "found a report of a shard after its end", event.gang)
        if isinstance(event.report, ShardProgress):
            self._faults.progressed(playing.shard.key, event.report.episodes)
        playing.has_ended = isinstance(event.report, ShardDone | ShardStopped)
        yield told.Report(playing.shard, event.report)

    def _handle_gang_freed(self, event: told.GangFreed) -> Iterable[Instruction]:
        playing = self._player(event, event.gang)
        if not playing.has_ended:
            raise self._impossible(event, "found a gang that left its shard without a word of how it ended", event.gang)
        del self._playing[event.gang]
        self._over.add(playing.shard.key)
        self._idle.append(playing.gang)
        return ()

    def _handle_gang_lost(self, event: told.GangLost, now: float) -> Iterator[Instruction]:
        """Let the shard begin again, from its checkpoint, unless its processes die again and again."""
        playing = self._player(event, event.gang)
        shard = playing.shard
        del self._playing[event.gang]
        yield told.Dismiss(event.gang)
        if playing.has_ended:  # its results are stored; what is lost is a process that had nothing left to do
            self._over.add(shard.key)
            return
        delay = self._faults.failed(shard.key)
        num_faults = self._faults.in_a_row(shard.key)
        if delay is None or self.is_stopping:
            self._over.add(shard.key)
        if delay is None:
            message = f"{shard.label}: its processes died {num_faults} times; the last: {event.reason}"
            yield self._give_up(ShardLostError(message), event.cause)
            return
        if not self.is_stopping:
            self._delayed.append(_Delayed(now + delay, shard))
        yield told.Report(shard, ShardRestarted(num_faults, delay, event.reason))

    def _handle_gang_failed(self, event: told.GangFailed) -> Iterator[Instruction]:
        self._over.add(self._player(event, event.gang).shard.key)
        del self._playing[event.gang]
        yield told.Dismiss(event.gang)
        yield self._give_up(event.error, event.cause)

    def _queue_due(self, now: float) -> None:
        """Put shards whose back-off is over before all others."""
        due = [one.shard for one in self._delayed if one.ready_at <= now]
        self._delayed = [one for one in self._delayed if one.ready_at > now]
        self._queue.extendleft(due)

    def _balance(self, num_cpus: int) -> Iterator[Instruction]:
        num_idle = len(self._idle)
        num_waiting = len(self._queue) + len(self._delayed)
        change = gangs_to_hire(num_cpus, num_idle + len(self._playing), num_idle, num_waiting)
        for _ in range(change):
            gang = self._new_gang(self._queue[0].arm.learner_gpus if self._queue else ())
            self._idle.append(gang)
            yield told.Hire(gang.number, gang.gpus)
        for _ in range(-change):
            yield told.Dismiss(self._idle.pop().number)

    def _begin_shards(self) -> Iterator[Instruction]:
        # A shard that waits out its back-off keeps its place: the gang in place of its lost one is for it.
        while self._queue and len(self._idle) > len(self._delayed):
            shard = self._queue.popleft()
            fitting = [gang for gang in self._idle if gang.gpus == shard.arm.learner_gpus]
            if fitting:
                gang = fitting[0]
                self._idle.remove(gang)
            else:
                yield told.Dismiss(self._idle.pop().number)
                gang = self._new_gang(shard.arm.learner_gpus)
                yield told.Hire(gang.number, gang.gpus)
            self._playing[gang.number] = _Playing(gang, shard)
            yield told.Start(gang.number, shard)

    def _new_gang(self, gpus: Sequence[float]) -> _Gang:
        gang = _Gang(self._num_hired, tuple(gpus))
        self._num_hired += 1
        return gang

    def _player(self, event: PoolEvent, gang: int) -> _Playing:
        if gang not in self._playing:
            raise self._impossible(event, "found an event of a gang that plays no shard", gang)
        return self._playing[gang]

    def _give_up(self, error: Exception, cause: Exception | None = None) -> told.GiveUp:
        self._has_given_up = True
        return told.GiveUp(error, cause)

    def _impossible(self, event: PoolEvent, what: str, gang: int | None = None) -> ImpossibleStateError:
        return ImpossibleStateError(f"{what}: {told.in_words(event)}", story=self._story.lines(gang))

    def validate(self) -> None:
        """Check what must hold between any two events; for tests.

        Raises
        ------
        ImpossibleStateError
            If it does not; the message names the rule.
        """
        waiting = [shard.key for shard in (*self._queue, *(one.shard for one in self._delayed))]
        played = [playing.shard.key for playing in self._playing.values()]
        gangs = [*self._idle, *(playing.gang for playing in self._playing.values())]
        numbers = [gang.number for gang in gangs]
        rules = {
            "a shard waits, is played, or is over": sorted([*waiting, *played, *self._over]) == sorted(self._shards),
            "a gang is idle, or plays": len(set(numbers)) == len(numbers)
            and numbers[len(self._idle) :] == list(self._playing),
            "gangs have the numbers of those that were hired": all(0 <= number < self._num_hired for number in numbers),
            "who plays has the GPUs of the shard": all(
                playing.gang.gpus == playing.shard.arm.learner_gpus for playing in self._playing.values()
            ),
            "a back-off follows a fault": all(self._faults.in_a_row(one.shard.key) for one in self._delayed),
            "no shard waits for a job that stops": not (self.is_stopping and waiting),
        }
        for rule, holds in rules.items():
            if not holds:
                message = f"found a pool that breaks a rule: {rule}"
                raise ImpossibleStateError(message, story=self._story.lines())
