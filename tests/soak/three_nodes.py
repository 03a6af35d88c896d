"""Three Ray nodes on this machine's loopback: a head without CPUs, and two workers that may be lost."""

from __future__ import annotations

import os
import random
import re
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import psutil

# Before Ray is imported: without tokens, and with its files apart from those of any other cluster.
ENVIRONMENT = {"RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
# A node whose processes are gone counts as lost within two seconds, not after a quarter of a minute.
_HEALTH = {
    "health_check_initial_delay_ms": 0,
    "health_check_period_ms": 500,
    "health_check_failure_threshold": 3,
}
_NODE = {"object_store_memory": 80 * 2**20}
_LEARNER, _COORDINATOR = re.compile(r"ray::LearnerHost\b"), re.compile(r"ray::(.+ · runs \d+-\d+)")
_IDLE_COORDINATOR = re.compile(r"ray::PacedCoordinator\b")


@contextmanager
def three_nodes(worker_cpus: tuple[int, ...] = (2, 1)) -> Iterator[ThreeNodes]:
    """Start them; must be called in the main thread of a process that has not imported Ray."""
    with tempfile.TemporaryDirectory(prefix="soak-", ignore_cleanup_errors=True) as folder:
        os.environ |= {**ENVIRONMENT, "RAY_TMPDIR": folder}
        os.environ.pop("RAY_ADDRESS", None)
        nodes = ThreeNodes(worker_cpus)
        try:
            yield nodes
        finally:
            nodes.shutdown()


class ThreeNodes:
    """The cluster, and the processes that run in it."""

    def __init__(self, worker_cpus: tuple[int, ...]) -> None:
        from ray.cluster_utils import Cluster

        head = {"num_cpus": 0, "include_dashboard": False, "_system_config": _HEALTH, **_NODE}
        self._cluster: Any = Cluster(initialize_head=True, head_node_args=head)
        self._workers: dict[Any, int] = {}
        self._orphans: list[psutil.Process] = []
        for num_cpus in worker_cpus:
            self._add(num_cpus)
        self._cluster.wait_for_nodes()

    @property
    def address(self) -> str:
        """For drivers."""
        return str(self._cluster.address)

    def learners(self) -> dict[psutil.Process, str]:
        """The processes of learner hosts with their titles."""
        return self._titled(_LEARNER)

    def coordinators(self) -> dict[psutil.Process, str]:
        """The processes of coordinators that play a shard, with its label."""
        return self._titled(_COORDINATOR)

    def lose_and_replace(self, moment: random.Random) -> list[str]:
        """Kill all processes of a worker node at once, and start another; the labels of the shards that were played
        there. A node where nothing is played is let alone.
        """
        node = moment.choice(list(self._workers))
        shards = sorted(self._titled(_COORDINATOR, [node]).values())
        if not shards:
            return []
        num_cpus = self._workers.pop(node)
        # They are no children of the node's any more once it is gone, and must go all the same.
        self._orphans += self._descendants(node)
        self._cluster.remove_node(node, allow_graceful=False)
        self._add(num_cpus)
        return shards

    def died_unasked(self) -> int:
        """How many worker nodes have died by themselves; they are replaced."""
        dead = [node for node in self._workers if not self._is_up(node)]
        for node in dead:
            num_cpus = self._workers.pop(node)
            with suppress(AssertionError, OSError):
                self._cluster.remove_node(node, allow_graceful=False)
            self._add(num_cpus)
        return len(dead)

    def left_over(self, seconds: float = 15.0) -> list[str]:
        """What is there of a job that is over: actors, placement groups, processes; it may take a moment to go."""
        deadline = time.monotonic() + seconds
        while (found := self._left_over()) and time.monotonic() < deadline:
            time.sleep(0.2)
        return found

    def shutdown(self) -> None:
        """End all its processes."""
        self._cluster.shutdown()

    def _left_over(self) -> list[str]:
        state = self._cluster.global_state
        actors: Mapping[str, Any] = state.actor_table(None) or {}
        groups: Mapping[str, Any] = state.placement_group_table(None) or {}
        found = [f"actor {actor['Name']}: {actor['State']}" for actor in actors.values() if actor["State"] != "DEAD"]
        found += [
            f"group {group['name']}: {group['state']}" for group in groups.values() if group["state"] != "REMOVED"
        ]
        titles = {**self.learners(), **self.coordinators(), **self._titled(_IDLE_COORDINATOR)}
        found += [f"process {process.pid}: {title}" for process, title in titles.items()]
        found += [f"process {process.pid} of a lost node" for process in self._orphans if _is_alive(process)]
        return found

    def _add(self, num_cpus: int) -> None:
        node = self._cluster.add_node(num_cpus=num_cpus, **_NODE)
        self._workers[node] = num_cpus

    def _is_up(self, node: Any) -> bool:
        return all(info.process.poll() is None for infos in node.all_processes.values() for info in infos)

    def _titled(self, pattern: re.Pattern[str], nodes: Iterable[Any] | None = None) -> dict[psutil.Process, str]:
        found = {}
        for node in self._workers if nodes is None else nodes:
            for process in self._descendants(node):
                with suppress(psutil.Error, IndexError):
                    if match := pattern.match(process.cmdline()[0]):
                        found[process] = match.group(match.lastindex or 0)
        return found

    def _descendants(self, node: Any) -> list[psutil.Process]:
        found: list[psutil.Process] = []
        for info in node.all_processes.get("raylet", []):
            with suppress(psutil.Error):
                found += psutil.Process(info.process.pid).children(recursive=True)
        return found


def _is_alive(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False
