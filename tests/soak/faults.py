"""What can happen to a job: small objects that make it happen."""

from __future__ import annotations

import random
import time
from contextlib import suppress
from typing import Protocol

import psutil

from tests.soak.job import Job
from tests.soak.storage_proxy import MODES, StorageProxy
from tests.soak.three_nodes import ThreeNodes

# A storage's fault of this length is over before the last of the attempts that `jobs.results.storage.Folder` makes.
_SHORTEST_SECONDS, _LONGEST_SECONDS = 0.5, 2.5
_OUTAGE_SECONDS = 120.0


class FaultError(Exception):
    """A job that took a fault in another way than it should."""


class Injector(Protocol):
    """A kind of fault."""

    name: str

    def inject(self, moment: random.Random) -> str:
        """Make it happen now; what was hit, empty if there was nothing to be hit."""
        ...


class LearnerKill:
    """A learner host dies."""

    name = "learner killed"

    def __init__(self, nodes: ThreeNodes) -> None:
        self._nodes = nodes

    def inject(self, moment: random.Random) -> str:
        """See `Injector`."""
        return _kill_one(self._nodes.learners(), moment)


class CoordinatorKill:
    """A coordinator dies while it plays a shard; its learners die with it."""

    name = "coordinator killed"

    def __init__(self, nodes: ThreeNodes) -> None:
        self._nodes = nodes

    def inject(self, moment: random.Random) -> str:
        """See `Injector`."""
        return _kill_one(self._nodes.coordinators(), moment)


class NodeLoss:
    """A worker node goes with all its processes, and another one joins."""

    name = "node lost"

    def __init__(self, nodes: ThreeNodes) -> None:
        self._nodes = nodes

    def inject(self, moment: random.Random) -> str:
        """See `Injector`."""
        return ", ".join(self._nodes.lose_and_replace(moment))


class DriverKill:
    """The driver dies, and the same command is given again."""

    name = "driver killed"

    def __init__(self, job: Job) -> None:
        self._job = job

    def inject(self, moment: random.Random) -> str:
        """See `Injector`."""
        if self._job.poll() is not None:
            return ""
        process = self._job.kill()
        self._job.start()
        return f"process {process}"


class StorageFault:
    """The storage is in a bad way for less time than a job is patient."""

    name = "storage fault"

    def __init__(self, proxy: StorageProxy) -> None:
        self._proxy = proxy

    def inject(self, moment: random.Random) -> str:
        """See `Injector`."""
        mode, share = moment.choice(list(MODES)), moment.choice([1.0, 0.5])
        seconds = moment.uniform(_SHORTEST_SECONDS, _LONGEST_SECONDS)
        before = self._proxy.num_hit
        with self._proxy.fault(mode, share):
            time.sleep(seconds)
        num_hit = self._proxy.num_hit - before
        return f"{mode} for {seconds:.1f} s: {num_hit} requests" if num_hit else ""


class StorageOutage:
    """The storage is away for so long that the job gives up, with a message; then the same command is given again."""

    name = "storage outage"

    def __init__(self, proxy: StorageProxy, job: Job) -> None:
        self._proxy, self._job = proxy, job

    def inject(self, moment: random.Random) -> str:
        """See `Injector`.

        Raises
        ------
        FaultError
            If the job ends in another way than with exit code 1 and one clear message.
        """
        if self._job.poll() is not None:
            return ""
        mode = moment.choice(["reset", "SlowDown"])
        began = time.monotonic()
        with self._proxy.fault(mode):
            code = self._job.wait(_OUTAGE_SECONDS)
        said = self._job.said()
        self._job.start()
        lines = said.splitlines()
        if code != 1 or len(lines) != 1 or not lines[0].startswith("error: ") or "s3://" not in lines[0]:
            message = f"{self.name} ({mode}): expected exit code 1 and one error, found {code} and\n{said}"
            raise FaultError(message)
        return f"{mode}: job gave up after {time.monotonic() - began:.1f} s"


def all_injectors(nodes: ThreeNodes, job: Job, proxy: StorageProxy) -> list[tuple[Injector, int]]:
    """One of each kind, with how many of a hundred faults it makes."""
    return [
        (LearnerKill(nodes), 27),
        (CoordinatorKill(nodes), 21),
        (NodeLoss(nodes), 15),
        (DriverKill(job), 14),
        (StorageFault(proxy), 19),
        (StorageOutage(proxy, job), 4),
    ]


def deck(injectors: list[tuple[Injector, int]], num_faults: int, moment: random.Random) -> list[Injector]:
    """So many faults in random order, of each kind its share and at least one."""
    hundredth = num_faults / sum(weight for _, weight in injectors)
    counts = [max(1, round(weight * hundredth)) for _, weight in injectors]
    # What rounding has added or taken away comes from the most frequent kind.
    counts[0] = max(1, counts[0] + num_faults - sum(counts))
    cards = [injector for (injector, _), count in zip(injectors, counts, strict=True) for _ in range(count)]
    moment.shuffle(cards)
    return cards


def _kill_one(processes: dict[psutil.Process, str], moment: random.Random) -> str:
    if not processes:
        return ""
    victim = moment.choice(sorted(processes, key=lambda process: process.pid))
    with suppress(psutil.NoSuchProcess):
        victim.kill()
        return f"{processes[victim]} (process {victim.pid})"
    return ""
