"""The only place that says ``ray.init``, ``ray.remote`` and ``.options``.

A *gang* is a coordinator with one host actor per learner, in one placement group of one CPU: gangs are placed whole
or not at all, so that any number of them can wait for room without blocking each other. Actors never restart on their
own, since their state would be fresh and the results wrong: when one dies its gang is replaced (`cluster.pool`), and
the shard goes on from its last checkpoint.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import ray
from ray._private import ray_constants, services
from ray.util.placement_group import placement_group, placement_group_table, remove_placement_group
from ray.util.scheduling_strategies import PlacementGroupSchedulingStrategy

from apel.experience.trajectory import Episodes
from apel.learners.base import Failure, Played, State
from cluster.coordinator import Coordinator
from cluster.errors import ClusterError, LostClusterError
from cluster.learner_host import LearnerHost
from cluster.local import LocalHosts
from cluster.protocols import Hosts
from cluster.reachability import check_reachable
from cluster.shard import Execution, Shard

ObjectRef = Any  # ray's own is generic in a type that nothing here can check
# Batches below this size travel inside the messages; Ray's own limit of 100 kB sends most of them through the object
# store, which costs several times as much.
_INLINE_BYTES = 2_000_000
_CLOSE_SECONDS = 4.0
"""For environments to be closed: a host first ends its round."""


@dataclass(frozen=True)
class ClusterInfo:
    """What there is to say about the cluster that was joined or started."""

    dashboard_url: str
    num_cpus: int
    log_folder: Path
    """Of this machine's part of the Ray session; the dashboard serves what lies there."""


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
    check_reachable(_found_address(address))
    if ray.is_initialized():
        yield _info("")
        return
    dashboard_url = _connect(address, num_cpus, dashboard=dashboard)
    try:
        if not num_cpus_of_cluster():
            message = "found a Ray cluster without CPUs, expected at least one: start a worker node first"
            raise ClusterError(message)
        yield _info(dashboard_url)
    finally:
        ray.shutdown()


def _found_address(address: str | None) -> str | None:
    """What ``auto`` stands for, which Ray would try for a quarter of an hour though nobody is there any more."""
    if address != "auto" or ray.is_initialized():
        return address
    try:
        found: str | None = services.get_ray_address_from_environment("auto", None)
    except ConnectionError as error:
        message = (
            "found no Ray cluster on this machine, expected one for --address auto: start it with `ray start --head`, "
            "or give HOST:PORT"
        )
        raise ClusterError(message) from error
    return found


def _connect(address: str | None, num_cpus: int | None, *, dashboard: bool) -> str:
    """Join or start a cluster; the dashboard's address."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Ray's coming default; the present one warns in every process.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    options: dict[str, Any] = {"address": address or "local", "log_to_driver": False, "logging_level": "ERROR"}
    if address is None:
        system = {"max_direct_call_object_size": _INLINE_BYTES}
        options |= {"num_cpus": num_cpus, "include_dashboard": dashboard, "_system_config": system}
        options |= {"_node_ip_address": "127.0.0.1"}
    handler = signal.getsignal(signal.SIGTERM)
    try:
        with _at_loopback(only=address is None):
            context = ray.init(**options)
    except Exception as error:  # among them bare ones, where a node does not come up in time
        reach = f"reach a Ray cluster at {address!r} (is its token in RAY_AUTH_TOKEN or RAY_AUTH_TOKEN_PATH?)"
        message = f"could not {'start Ray on this machine' if address is None else reach}: {error}"
        raise ClusterError(message) from error
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)  # Ray puts its own, which ends the process at once, in its place
    return context.dashboard_url or ""


@contextmanager
def _at_loopback(*, only: bool) -> Iterator[None]:
    """Within, Ray takes the loopback's address for this machine's, as it does on a Mac: nobody else shall reach a Ray
    that is started for one job. Elsewhere it would put the address that others see in its place.
    """
    before = ray_constants.ENABLE_RAY_CLUSTER
    ray_constants.ENABLE_RAY_CLUSTER = before and not only
    try:
        yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = before


def _info(dashboard_url: str) -> ClusterInfo:
    context: Any = ray.get_runtime_context()
    log_folder = Path(context.get_temp_dir(), context.get_session_name(), "logs")
    return ClusterInfo(dashboard_url, num_cpus_of_cluster(), log_folder)


def refuse_lost_cluster() -> None:
    """See that the processes of a Ray that was started here are there; those of another one its own machine watches.

    Raises
    ------
    LostClusterError
        If one of them has died: nothing that is asked of Ray then would ever be answered.
    """
    node: Any = ray._private.worker._global_node
    processes = [] if node is None else node.dead_processes()
    dead = [kind for kind, _ in processes if kind in ("raylet", "gcs_server")]
    if dead:
        message = (
            f"the Ray on this machine has lost its {dead[0]}, which the system may have ended for want of memory: what "
            "is finished is stored, and the same command resumes from the last checkpoints"
        )
        raise LostClusterError(message)


def num_cpus_of_cluster() -> int:
    """How many CPUs the nodes that are there now have together, whoever uses them."""
    resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
    return int(resources.get("CPU", 0))


def num_gpus_of_cluster() -> float:
    """How many GPUs the nodes that are there now have together, whoever uses them."""
    resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
    return resources.get("GPU", 0.0)


def _get(references: list[ObjectRef]) -> list[Any]:
    """The values; an error of an actor's own code is raised as it was there, without Ray's account of where."""
    try:
        values: list[Any] = ray.get(references)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error
    return values


def await_all(calls: Sequence[ObjectRef]) -> None:
    """Wait a few seconds for calls to end, in whatever way."""
    if calls:
        with suppress(Exception):
            ray.wait(list(calls), num_returns=len(calls), timeout=_CLOSE_SECONDS)


class RemoteHosts:
    """Learner hosts that are actors. Trajectories go from host to host; the coordinator only passes references on."""

    def __init__(self, actors: Sequence[Any]) -> None:
        self._all = list(actors)
        self._actors: list[Any] = []
        self._plays: list[Any] = []
        self._last: list[ObjectRef | None] = []

    def prepare(self, shard: Shard, execution: Execution, states: Sequence[State] | None) -> None:
        """See `cluster.protocols.Hosts`."""
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
        """See `cluster.protocols.Hosts`."""
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

    def catch_up(self) -> list[tuple[Failure, ...]]:
        """See `cluster.protocols.Hosts`."""
        answers: list[tuple[Failure, ...]] = [() for _ in self._actors]
        others = {index: self._others(index) for index in range(len(self._actors))}
        calls = {i: self._actors[i].catch_up.remote(*batches) for i, batches in others.items() if batches}
        self._last = [None] * len(self._actors)
        for index, failures in zip(calls, _get(list(calls.values())), strict=True):
            answers[index] = failures
        return answers

    def states(self) -> list[tuple[State, tuple[Failure, ...]]]:
        """See `cluster.protocols.Hosts`."""
        calls = [actor.state.remote(*self._others(index)) for index, actor in enumerate(self._actors)]
        self._last = [None] * len(self._actors)
        states: list[tuple[State, tuple[Failure, ...]]] = _get(calls)
        return states

    def models(self, runs: Sequence[int]) -> list[tuple[list[State], tuple[Failure, ...]]]:
        """See `cluster.protocols.Hosts`."""
        calls = [actor.models.remote(runs, *self._others(index)) for index, actor in enumerate(self._actors)]
        self._last = [None] * len(self._actors)
        models: list[tuple[list[State], tuple[Failure, ...]]] = _get(calls)
        return models

    def close(self) -> None:
        """See `cluster.protocols.Hosts`; hosts that are gone, or do not answer, are left alone."""
        await_all([actor.close.remote() for actor in self._actors])

    def _others(self, index: int) -> list[ObjectRef]:
        return [batch for other, batch in enumerate(self._last) if other != index and batch is not None]


class Gang:
    """A coordinator actor and its hosts.

    Attributes
    ----------
    gpus:
        The share of GPUs of each host; empty where none has any. Without hosts of their own the learners live in the
        coordinator, which gets them all.
    """

    def __init__(
        self, name: str, num_hosts: int, gpus: Sequence[float], make_coordinator: Callable[[Hosts], tuple[Any, ...]]
    ) -> None:
        self.gpus = tuple(gpus)
        bundle = {"CPU": 1.0, "GPU": sum(gpus)} if gpus else {"CPU": 1.0}
        self._group = placement_group([bundle], strategy="STRICT_PACK", name=name)
        options: dict[str, Any] = {
            "scheduling_strategy": PlacementGroupSchedulingStrategy(self._group, placement_group_bundle_index=0),
            "max_restarts": 0,
            "max_task_retries": 0,
        }
        # Ray counts CPUs in ten-thousandths; rounding down keeps the hosts within the gang's one CPU.
        share = np.floor(10_000 / max(num_hosts, 1)) / 10_000
        host_class: Any = ray.remote(LearnerHost)
        # Apart from `run`, which takes as long as a shard does: it must be possible to tell a coordinator to stop.
        remote: Any = ray.remote
        coordinator_class = remote(concurrency_groups={"control": 1})(Coordinator)
        shares = [*gpus, *[0.0] * (num_hosts - len(gpus))][:num_hosts]
        self._hosts = [
            host_class.options(name=f"{name}/learner-{i}", num_cpus=share, num_gpus=gpu, **options).remote()
            for i, gpu in enumerate(shares)
        ]
        hosts = RemoteHosts(self._hosts) if num_hosts else LocalHosts()
        own = {"num_cpus": 0} if num_hosts else {"num_cpus": 1, "num_gpus": sum(gpus)}
        self._coordinator = coordinator_class.options(name=f"{name}/coordinator", **own, **options).remote(
            *make_coordinator(hosts)
        )

    def start(self, shard: Shard) -> Any:
        """Begin a shard: a generator of references to its progress."""
        return self._coordinator.run.options(name=shard.label, num_returns="streaming").remote(shard)

    def is_placed(self) -> bool:
        """Whether the cluster had room for it."""
        # Not its `wait` without any time: on a busy machine that does not get as far as asking.
        return bool(placement_group_table(self._group)["state"] == "CREATED")

    def stop(self) -> None:
        """Ask the shard under way to write a checkpoint and end."""
        self._coordinator.stop.options(concurrency_group="control").remote()

    def close(self) -> list[ObjectRef]:
        """Ask it to close its environments; calls that end when they are."""
        with suppress(Exception):
            if self.is_placed():
                calls = [host.close.remote() for host in self._hosts]
                return [*calls, self._coordinator.close.options(concurrency_group="control").remote()]
        return []

    def kill(self) -> None:
        """End all its processes and give back its CPU."""
        for actor in (self._coordinator, *self._hosts):
            with suppress(Exception):
                ray.kill(actor)
        with suppress(Exception):
            remove_placement_group(self._group)
