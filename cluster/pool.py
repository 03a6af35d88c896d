"""Plays shards on a Ray cluster, as many at once as it has CPUs, whatever happens to its processes and nodes.

There are as many gangs (`cluster.launch.Gang`) as CPUs; they are kept for the whole job, and take one shard after the
other. A gang whose processes die is not mended: its shard waits a moment, and begins again with another gang from its
last checkpoint.

All of this is decided in `cluster.pool_state`; here Ray is asked what happened, and told what to do.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal

import ray

from cluster import pool_events as told
from cluster.errors import ClusterError, LostClusterError
from cluster.events import ShardEvent
from cluster.launch import Gang, await_all, num_cpus_of_cluster, num_gpus_of_cluster, refuse_lost_cluster
from cluster.pool_events import PoolEvent
from cluster.pool_state import PoolState
from cluster.protocols import CheckpointStore, Hosts, ResultSink
from cluster.retry import RetryPolicy
from cluster.shard import Execution, Shard

GangLayout = Literal["actors", "packed"]
"""``actors``: every learner and coordinator a Ray actor of its own; ``packed``: all of a gang in one."""

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
_COUNT_CPUS_SECONDS = 1.0
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


def event_of_error(gang: int, error: ray.exceptions.RayError) -> told.GangLost | told.GangFailed:
    """Whether the infrastructure was at fault, which may go better another time, or the code that the gang runs."""
    # A coordinator that lost a learner passes the fault on, with an account of where, as its cause.
    cause = getattr(error, "cause", None)
    fault = cause if isinstance(cause, Exception) else error
    if isinstance(fault, ray.exceptions.RayActorError) and fault.actor_init_failed:
        return told.GangFailed(gang, ClusterError(_of_unmade_actor(str(fault))), error)
    if isinstance(error, _INFRASTRUCTURE_FAULTS) or isinstance(fault, _INFRASTRUCTURE_FAULTS):
        return told.GangLost(gang, str(fault).splitlines()[0], error)
    return told.GangFailed(gang, fault, error if fault is not error else None)


def _of_unmade_actor(account: str) -> str:
    """What an actor's constructor raised, and Ray's account of it: it would do so again."""
    lines = [line.rstrip() for line in _COLOUR.sub("", account).splitlines() if line.strip()]
    return "\n".join((f"a process of the job could not be made ready: {lines[-1] if lines else account}", *lines))


class ShardPool:
    """The gangs of a job, and the shards that they play."""

    def __init__(
        self,
        experiment: str,
        layout: GangLayout,
        sink: ResultSink,
        checkpoints: CheckpointStore,
        execution: Execution,
        retry: RetryPolicy | None = None,
    ) -> None:
        self._experiment = experiment
        self._layout = layout
        self._parts = (sink, checkpoints, execution)
        self._state = PoolState(retry)
        self._num_hosts = 0
        self._counted_at = -_COUNT_CPUS_SECONDS
        self._gangs: dict[int, Gang] = {}
        self._generators: dict[int, Any] = {}
        """Of the reports of the gangs that play."""

    @property
    def num_restarts(self) -> int:
        """How many times a shard had to begin again."""
        return self._state.num_restarts

    def run(
        self, shards: Sequence[Shard], stopping: Callable[[], bool] = lambda: False
    ) -> Iterator[tuple[Shard, ShardEvent]]:
        """Play all shards, in any order, until all are done or ``stopping()`` says to stop; yields what happens.

        A pool plays one job, once.

        Raises
        ------
        ShardLostError
            If a shard's processes died too often.
        LostClusterError
            If the Ray that was started here has died.
        ClusterError
            If a shard wants more GPUs than the cluster has.
        """
        if self._layout == "actors":
            self._num_hosts = max((len(shard.arm.learner_names) for shard in shards), default=0)
        try:
            yield from self._tell(told.JobBegun(tuple(shards), num_gpus_of_cluster()))
            while not self._state.is_over:
                refuse_lost_cluster()
                for event in self._noticed(stopping):
                    yield from self._tell(event)
        except LostClusterError:
            self._gangs.clear()  # there is nobody who could end them, or who had to
            raise
        finally:
            self._end_all()

    def _end_all(self) -> None:
        await_all([call for gang in self._gangs.values() for call in gang.close()])
        for gang in self._gangs.values():
            gang.kill()

    def _noticed(self, stopping: Callable[[], bool]) -> Iterator[PoolEvent]:
        """What is to be seen from here, without any gang."""
        if stopping() and not self._state.is_stopping:
            yield told.StopAsked(frozenset(gang for gang in self._generators if self._gangs[gang].is_placed()))
        now = time.monotonic()
        if now - self._counted_at >= _COUNT_CPUS_SECONDS:
            self._counted_at = now
            yield told.CpusCounted(num_cpus_of_cluster())
        yield told.Tick()

    def _tell(self, event: PoolEvent) -> Iterator[tuple[Shard, ShardEvent]]:
        """Do what the state answers."""
        for instruction in self._state.handle(event, time.monotonic()):
            match instruction:
                case told.Report(shard, report):
                    yield shard, report
                case told.Wait():
                    heard = self._heard(instruction)
                    if heard is not None:
                        yield from self._tell(heard)
                case told.GiveUp(error, cause):
                    raise error from cause
                case _:
                    self._order(instruction)

    def _order(self, instruction: told.Hire | told.Dismiss | told.Start | told.AskToStop) -> None:
        match instruction:
            case told.Hire(gang, gpus):
                name = f"{self._experiment}/gang-{gang}"
                self._gangs[gang] = Gang(name, self._num_hosts, gpus, self._coordinator_parts)
            case told.Dismiss(gang):
                self._generators.pop(gang, None)
                ended = self._gangs.pop(gang)
                await_all(ended.close())
                ended.kill()
            case told.Start(gang, shard):
                self._generators[gang] = self._gangs[gang].start(shard)
            case told.AskToStop(gang):
                self._gangs[gang].stop()

    def _heard(self, wait: told.Wait) -> PoolEvent | None:
        """What one of the gangs has to say; None where none has."""
        if not wait.gangs:
            time.sleep(wait.seconds)
            return None
        gangs = {self._generators[gang]: gang for gang in wait.gangs}
        ready: list[Any] = ray.wait(list(gangs), num_returns=1, timeout=wait.seconds)[0]
        return self._next_event(gangs[ready[0]]) if ready else None

    def _next_event(self, gang: int) -> PoolEvent:
        try:
            return told.GangReported(gang, ray.get(next(self._generators[gang])))
        except StopIteration:
            del self._generators[gang]
            return told.GangFreed(gang)
        except ray.exceptions.RayError as error:
            return event_of_error(gang, error)

    def _coordinator_parts(self, hosts: Hosts) -> tuple[Any, ...]:
        return (hosts, *self._parts)
