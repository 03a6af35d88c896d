"""Plays shards on a Ray cluster, as many at once as it has CPUs, whatever happens to its processes and nodes.

There are as many gangs (`cluster.launch.Gang`) as CPUs; they are kept for the whole job, and take one shard after the
other. A gang whose processes die is not mended: its shard waits a moment, and begins again with another gang from its
last checkpoint.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import ray

from cluster.errors import ClusterError, ShardLostError
from cluster.events import ShardEvent, ShardProgress, ShardRestarted, ShardWaiting
from cluster.launch import Gang, num_cpus_of_cluster, num_gpus_of_cluster
from cluster.protocols import CheckpointStore, Hosts, ResultSink
from cluster.retry import FaultCounter, RetryPolicy
from cluster.shard import Execution, Shard

Placement = Literal["actors", "packed"]

_INFRASTRUCTURE_FAULTS = (
    ray.exceptions.RayActorError,
    ray.exceptions.WorkerCrashedError,
    ray.exceptions.ObjectLostError,
    ray.exceptions.NodeDiedError,
    ray.exceptions.OutOfMemoryError,
    ray.exceptions.LocalRayletDiedError,
    ray.exceptions.TaskPlacementGroupRemoved,
    ray.exceptions.ActorPlacementGroupRemoved,
)
_POLL_SECONDS = 0.5
_COUNT_CPUS_SECONDS = 1.0


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


@dataclass
class _Delayed:
    """A shard that begins again after its back-off."""

    ready_at: float
    shard: Shard


def _check_gpus(shards: Sequence[Shard]) -> None:
    """A gang that wants more than there is would wait for ever."""
    wanted = max((sum(shard.arm.learner_gpus) for shard in shards), default=0.0)
    if wanted and wanted > (found := num_gpus_of_cluster()):
        message = (
            f"found {found:g} GPUs in the Ray cluster, expected at least {wanted:g}: the num_gpus of an arm's learners"
        )
        raise ClusterError(message)


class ShardPool:
    """The gangs of a job, and the shards that they play."""

    def __init__(
        self,
        experiment: str,
        placement: Placement,
        sink: ResultSink,
        checkpoints: CheckpointStore,
        execution: Execution,
        retry: RetryPolicy | None = None,
    ) -> None:
        self._experiment = experiment
        self._placement = placement
        self._parts = (sink, checkpoints, execution)
        self._faults = FaultCounter(retry or RetryPolicy())
        self._queue: deque[Shard] = deque()
        self._delayed: list[_Delayed] = []
        self._idle: list[Gang] = []
        self._active: dict[Any, tuple[Gang, Shard]] = {}
        self._num_hosts = 0
        self._num_hired = 0
        self._num_cpus, self._counted_at = 0, -_COUNT_CPUS_SECONDS
        self._is_stopping = self._was_starved = False

    @property
    def num_restarts(self) -> int:
        """How many times a shard had to begin again."""
        return self._faults.total

    def run(
        self, shards: Sequence[Shard], stopping: Callable[[], bool] = lambda: False
    ) -> Iterator[tuple[Shard, ShardEvent]]:
        """Play all shards, in any order, until all are done or ``stopping()`` says to stop; yields what happens.

        Raises
        ------
        ShardLostError
            If a shard's processes died too often.
        ClusterError
            If a shard wants more GPUs than the cluster has.
        """
        _check_gpus(shards)
        self._queue = deque(shards)
        self._num_hosts = max((len(shard.arm.learner_names) for shard in shards), default=0)
        try:
            while self._queue or self._delayed or self._active:
                if stopping() and not self._is_stopping:
                    self._stop()
                yield from self._begin_shards()
                yield from self._wait()
        finally:
            for gang in (*self._idle, *(gang for gang, _ in self._active.values())):
                gang.kill()

    def _stop(self) -> None:
        """Begin nothing more; what is under way ends with a checkpoint."""
        self._is_stopping = True
        self._queue.clear()
        self._delayed.clear()
        for generator, (gang, _) in list(self._active.items()):
            if gang.is_placed():
                gang.stop()
            else:  # it has no process that could hear it, and may never have one
                del self._active[generator]
                gang.kill()

    def _begin_shards(self) -> Iterator[tuple[Shard, ShardEvent]]:
        """Give waiting shards to gangs; workers may join or leave at any time."""
        now = time.monotonic()
        due = [one for one in self._delayed if one.ready_at <= now]
        self._delayed = [one for one in self._delayed if one.ready_at > now]
        self._queue.extendleft(one.shard for one in due)
        if now - self._counted_at >= _COUNT_CPUS_SECONDS:
            self._num_cpus, self._counted_at = num_cpus_of_cluster(), now
        self._balance()
        # A shard that waits out its back-off keeps its place: the gang in place of its lost one is for it.
        while self._queue and len(self._idle) > len(self._delayed):
            shard = self._queue.popleft()
            gang = self._take_idle(shard.arm.learner_gpus)
            self._active[gang.start(shard)] = (gang, shard)
        starved = bool(self._queue) and self._num_cpus == 0
        if starved and not self._was_starved:
            yield self._queue[0], ShardWaiting()
        self._was_starved = starved

    def _take_idle(self, gpus: Sequence[float]) -> Gang:
        """An idle gang whose hosts have such GPUs; a new one in place of another where there is none."""
        for gang in self._idle:
            if gang.gpus == tuple(gpus):
                self._idle.remove(gang)
                return gang
        self._idle.pop().kill()
        return self._new_gang(gpus)

    def _balance(self) -> None:
        num_idle = len(self._idle)
        num_waiting = len(self._queue) + len(self._delayed)
        change = gangs_to_hire(self._num_cpus, num_idle + len(self._active), num_idle, num_waiting)
        for _ in range(change):
            self._idle.append(self._new_gang(self._wanted_gpus()))
        for _ in range(-change):
            self._idle.pop().kill()

    def _wait(self) -> Iterator[tuple[Shard, ShardEvent]]:
        generators: list[Any] = list(self._active)
        if not generators:
            time.sleep(_POLL_SECONDS)
            return
        ready: list[Any] = ray.wait(generators, num_returns=1, timeout=_POLL_SECONDS)[0]
        for generator in ready:
            gang, shard = self._active[generator]
            try:
                event: ShardEvent = ray.get(next(generator))
            except StopIteration:
                del self._active[generator]
                self._idle.append(gang)
                continue
            except ray.exceptions.RayError as error:
                del self._active[generator]
                gang.kill()
                event = self._recover(shard, error)
            if isinstance(event, ShardProgress):
                self._faults.progressed(shard.key, event.episodes)
            yield shard, event

    def _recover(self, shard: Shard, error: ray.exceptions.RayError) -> ShardRestarted:
        """Let the shard begin again, from its checkpoint, if the infrastructure was at fault."""
        # A coordinator that lost a learner passes the fault on, with an account of where, as its cause.
        cause = getattr(error, "cause", None)
        fault = cause if isinstance(cause, Exception) else error
        if not isinstance(error, _INFRASTRUCTURE_FAULTS) and not isinstance(fault, _INFRASTRUCTURE_FAULTS):
            raise fault
        line = str(fault).splitlines()[0]
        delay = self._faults.failed(shard.key)
        if delay is None:
            message = f"{shard.label}: its processes died {self._faults.in_a_row(shard.key)} times; the last: {line}"
            raise ShardLostError(message) from error
        if not self._is_stopping:
            self._delayed.append(_Delayed(time.monotonic() + delay, shard))
        return ShardRestarted(self._faults.in_a_row(shard.key), delay, line)

    def _wanted_gpus(self) -> Sequence[float]:
        """Those of the next shard in the queue."""
        return self._queue[0].arm.learner_gpus if self._queue else ()

    def _new_gang(self, gpus: Sequence[float]) -> Gang:
        name = f"{self._experiment}/gang-{self._num_hired}"
        self._num_hired += 1
        num_hosts = self._num_hosts if self._placement == "actors" else 0
        return Gang(name, num_hosts, gpus, self._coordinator_parts)

    def _coordinator_parts(self, hosts: Hosts) -> tuple[Any, ...]:
        return (hosts, *self._parts)
