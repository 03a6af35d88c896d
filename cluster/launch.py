"""The only place that says ``ray.init``, ``ray.remote`` and ``.options``.

A *gang* is a coordinator with one host actor per learner, in one placement group of one CPU: gangs are placed whole
or not at all, so that any number of them can wait for room without blocking each other. There are as many gangs as
CPUs, they are kept for the whole job, and take one shard after the other. Actors never restart on their own, since
their state would be fresh and the results wrong: when one dies its gang is replaced, and the shard goes on from its
last checkpoint.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import ray
from ray.util.placement_group import placement_group, remove_placement_group
from ray.util.scheduling_strategies import PlacementGroupSchedulingStrategy

from apel.learners.base import Failure, Played, State
from apel.trajectory import Episodes
from cluster.coordinator import CheckpointStore, Coordinator, Hosts, ResultSink, ShardDone, ShardProgress
from cluster.errors import ClusterError, ShardLostError
from cluster.learner_host import LearnerHost
from cluster.local import LocalHosts
from cluster.retry import RetryPolicy
from cluster.shard import Execution, Shard

ObjectRef = Any  # ray's own is generic in a type that nothing here can check
Placement = Literal["actors", "packed"]

# Batches below this size travel inside the messages; Ray's own limit of 100 kB sends most of them through the object
# store, which costs several times as much.
_INLINE_BYTES = 2_000_000
_REACH_SECONDS = 5.0
_INFRASTRUCTURE_FAULTS = (
    ray.exceptions.RayActorError,
    ray.exceptions.WorkerCrashedError,
    ray.exceptions.ObjectLostError,
    ray.exceptions.NodeDiedError,
    ray.exceptions.OutOfMemoryError,
    ray.exceptions.LocalRayletDiedError,
)


@dataclass(frozen=True)
class ClusterInfo:
    """What there is to say about the cluster that was joined or started."""

    dashboard_url: str
    num_cpus: int


@contextmanager
def ray_cluster(
    address: str | None = None, num_cpus: int | None = None, *, dashboard: bool = True
) -> Iterator[ClusterInfo]:
    """Join the cluster at ``address``, or start one on this machine and stop it at the end.

    A process that is connected to a cluster already stays with that one.

    Raises
    ------
    ClusterError
        If there is none at that address, or if it has no CPU.
    """
    _check_reachable(address)
    if ray.is_initialized():
        yield ClusterInfo("", _num_cpus())
        return
    dashboard_url = _connect(address, num_cpus, dashboard=dashboard)
    try:
        if not _num_cpus():
            message = "found a Ray cluster without CPUs, expected at least one: start a worker node first"
            raise ClusterError(message)
        yield ClusterInfo(dashboard_url, _num_cpus())
    finally:
        ray.shutdown()


def _connect(address: str | None, num_cpus: int | None, *, dashboard: bool) -> str:
    """Join or start a cluster; the dashboard's address."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Ray's coming default; the present one warns in every process.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    options: dict[str, Any] = {"address": address or "local", "log_to_driver": False, "logging_level": "ERROR"}
    if address is None:
        system = {"max_direct_call_object_size": _INLINE_BYTES}
        options |= {"num_cpus": num_cpus, "include_dashboard": dashboard, "_system_config": system}
    handler = signal.getsignal(signal.SIGTERM)
    try:
        context = ray.init(**options)
    except (ConnectionError, ValueError, RuntimeError) as error:
        reach = f"reach a Ray cluster at {address!r} (if it is there, is its token the one in RAY_AUTH_TOKEN?)"
        message = f"could not {'start Ray on this machine' if address is None else reach}: {error}"
        raise ClusterError(message) from error
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)  # Ray puts its own, which ends the process at once, in its place
    return context.dashboard_url or ""


def _check_reachable(address: str | None) -> None:
    """Ray itself goes on trying for a quarter of an hour where nothing listens."""
    host, separator, port = (address or "").rpartition(":")
    if not separator or not port.isdigit() or "://" in host:
        return
    try:
        socket.create_connection((host, int(port)), timeout=_REACH_SECONDS).close()
    except OSError as error:
        message = f"could not reach a Ray cluster at {address!r}: {error}"
        raise ClusterError(message) from error


def _num_cpus() -> int:
    resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
    return int(resources.get("CPU", 0))


def _get(references: list[ObjectRef]) -> list[Any]:
    """The values; an error of an actor's own code is raised as it was there, without Ray's account of where."""
    try:
        values: list[Any] = ray.get(references)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error
    return values


class RemoteHosts:
    """Learner hosts that are actors. Trajectories go from host to host; the coordinator only passes references on."""

    def __init__(self, actors: Sequence[Any]) -> None:
        self._all = list(actors)
        self._actors: list[Any] = []
        self._plays: list[Any] = []
        self._last: list[ObjectRef | None] = []

    def prepare(self, shard: Shard, execution: Execution, states: Sequence[State] | None) -> None:
        """See `cluster.coordinator.Hosts`."""
        self._actors = self._all[: len(shard.arm.learner_names)]
        self._plays = [actor.play.options(num_returns=2) for actor in self._actors]
        self._last = [None] * len(self._actors)
        _get(
            [
                actor.prepare.remote(shard, index, execution, states[index] if states is not None else None)
                for index, actor in enumerate(self._actors)
            ]
        )

    def play(self, orders: Sequence[Sequence[int]]) -> list[Played]:
        """See `cluster.coordinator.Hosts`."""
        answers: list[Played] = [Played(Episodes.empty(0)) for _ in self._actors]
        batches: list[ObjectRef | None] = [None] * len(self._actors)
        calls: dict[int, ObjectRef] = {}
        for index, play in enumerate(self._plays):
            others = self._others(index)
            if orders[index] or others:
                calls[index], batches[index] = play.remote(orders[index], *others)
        for index, played in zip(calls, _get(list(calls.values())), strict=True):
            answers[index] = played
        self._last = [
            batch if len(played.episodes.run) else None for batch, played in zip(batches, answers, strict=True)
        ]
        return answers

    def states(self) -> list[tuple[State, tuple[Failure, ...]]]:
        """See `cluster.coordinator.Hosts`."""
        calls = [actor.state.remote(*self._others(index)) for index, actor in enumerate(self._actors)]
        self._last = [None] * len(self._actors)
        states: list[tuple[State, tuple[Failure, ...]]] = _get(calls)
        return states

    def _others(self, index: int) -> list[ObjectRef]:
        return [batch for other, batch in enumerate(self._last) if other != index and batch is not None]


class _Gang:
    """A coordinator actor and its hosts."""

    def __init__(self, name: str, num_hosts: int, make_coordinator: Callable[[Hosts], tuple[Any, ...]]) -> None:
        self._group = placement_group([{"CPU": 1}], strategy="STRICT_PACK", name=name)
        options: dict[str, Any] = {
            "scheduling_strategy": PlacementGroupSchedulingStrategy(self._group, placement_group_bundle_index=0),
            "max_restarts": 0,
            "max_task_retries": 0,
        }
        # Ray counts CPUs in ten-thousandths; rounding down keeps the hosts within the gang's one CPU.
        share = np.floor(10_000 / max(num_hosts, 1)) / 10_000
        host_class: Any = ray.remote(LearnerHost)
        coordinator_class: Any = ray.remote(Coordinator)
        self._hosts = [
            host_class.options(name=f"{name}/learner-{i}", num_cpus=share, **options).remote() for i in range(num_hosts)
        ]
        hosts = RemoteHosts(self._hosts) if num_hosts else LocalHosts()
        self._coordinator = coordinator_class.options(
            name=f"{name}/coordinator", num_cpus=0 if num_hosts else 1, **options
        ).remote(*make_coordinator(hosts))

    def start(self, shard: Shard) -> Any:
        """Begin a shard: a generator of references to its progress."""
        return self._coordinator.run.options(name=shard.label, num_returns="streaming").remote(shard)

    def kill(self) -> None:
        """Stop all its processes and give back its CPU."""
        for actor in (self._coordinator, *self._hosts):
            with suppress(Exception):
                ray.kill(actor)
        with suppress(Exception):
            remove_placement_group(self._group)


class ShardPool:
    """Plays shards on a Ray cluster, as many at once as it has CPUs."""

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
        self._retry = retry or RetryPolicy()
        self._num_gangs = 0
        self._faults: dict[tuple[str, str, int], int] = {}
        self._idle: list[_Gang] = []
        self._active: dict[Any, tuple[_Gang, Shard]] = {}

    @property
    def num_restarts(self) -> int:
        """How many times a gang had to be replaced."""
        return sum(self._faults.values())

    def run(self, shards: Sequence[Shard]) -> Iterator[tuple[Shard, ShardProgress | ShardDone]]:
        """Play all shards, in any order; yields their progress, and for each that it is done.

        Raises
        ------
        ShardLostError
            If a shard's processes died too often.
        """
        queue = deque(shards)
        num_hosts = max((len(shard.arm.learner_names) for shard in shards), default=0)
        try:
            while queue or self._active:
                self._hire(len(queue), num_hosts)
                while queue and self._idle:
                    self._begin(self._idle.pop(), queue.popleft())
                yield from self._wait(num_hosts)
        finally:
            for gang in (*self._idle, *(gang for gang, _ in self._active.values())):
                gang.kill()

    def _hire(self, num_waiting: int, num_hosts: int) -> None:
        """Start gangs for waiting shards while there are CPUs: workers may join at any time."""
        free = _num_cpus() - len(self._active) - len(self._idle) if num_waiting > len(self._idle) else 0
        for _ in range(min(free, num_waiting - len(self._idle))):
            self._idle.append(self._new_gang(num_hosts))

    def _begin(self, gang: _Gang, shard: Shard) -> None:
        self._active[gang.start(shard)] = (gang, shard)

    def _wait(self, num_hosts: int) -> Iterator[tuple[Shard, ShardProgress | ShardDone]]:
        generators: list[Any] = list(self._active)
        if not generators:  # every CPU has left the cluster: wait for one to come back
            time.sleep(1.0)
            return
        ready: list[Any] = ray.wait(generators, num_returns=1, timeout=1.0)[0]
        for generator in ready:
            gang, shard = self._active[generator]
            try:
                yield shard, ray.get(next(generator))
            except StopIteration:
                del self._active[generator]
                self._idle.append(gang)
            except ray.exceptions.RayError as error:
                del self._active[generator]
                gang.kill()
                self._recover(shard, num_hosts, error)

    def _recover(self, shard: Shard, num_hosts: int, error: ray.exceptions.RayError) -> None:
        """Begin the shard again with a new gang, from its checkpoint, if the infrastructure was at fault."""
        cause = getattr(error, "cause", None)
        if not isinstance(error, _INFRASTRUCTURE_FAULTS) and not isinstance(cause, _INFRASTRUCTURE_FAULTS):
            raise cause if isinstance(cause, Exception) else error
        faults = self._faults[shard.key] = self._faults.get(shard.key, 0) + 1
        delay = self._retry.delay_seconds(faults)
        if delay is None:
            message = f"{shard.label}: its processes died {faults} times; the last time: {str(error).splitlines()[0]}"
            raise ShardLostError(message) from error
        time.sleep(delay)
        self._begin(self._new_gang(num_hosts), shard)

    def _new_gang(self, num_hosts: int) -> _Gang:
        name = f"{self._experiment}/gang-{self._num_gangs}"
        self._num_gangs += 1
        return _Gang(name, num_hosts if self._placement == "actors" else 0, lambda hosts: (hosts, *self._parts))
