"""Whose results these are at the moment: one job at a time computes an experiment in a folder.

Two jobs in one folder would cut the same runs into different shards and store some of them twice. Stores such as S3
offer no file lock, so that a *lease* is a file of its own per job, and the protocol needs no more than that a file
which was written is seen by whoever lists the folder afterwards:

1. write a lease that says ``wanting``;
2. look at all leases: where another one holds, or wants and comes before this one by name, take this one back and give
   up; where another one wants and comes after, wait for it to see the same and give up;
3. otherwise let the lease say ``holding``, and renew it, with a counter that grows, for as long as the job goes on.

A lease whose counter stands still is a dead job's, and has run out. How long it stands still is measured on the watch
of whoever looks, never by comparing the clocks of two machines: a clock that jumps changes nothing.

The term is that of Gray, C., Cheriton, D. (1989), *Leases: an efficient fault-tolerant mechanism for distributed file
cache consistency*, SOSP.
"""

from __future__ import annotations

import json
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from jobs.results.storage import Folder

LEASES = "claims"
"""The folder that they lie in, by the name under which jobs of all versions look for each other's."""


class BusyError(Exception):
    """Another job is computing into the same results. The message says which."""


@dataclass(frozen=True)
class Owner:
    """Who leases results: the machine (or container), the process, and the submitted job if it is one."""

    machine: str
    process: int
    started: str
    """Tells a process from an earlier one of the same number."""
    job: str

    def __str__(self) -> str:
        job = f"job {self.job}, " if self.job else ""
        return f"{job}process {self.process} on {self.machine.split('/')[0]}"


@dataclass(frozen=True)
class Timing:
    """Seconds between two signs of life, without any until a lease counts as dead, and between two looks."""

    renew_seconds: float = 5.0
    dead_seconds: float = 30.0
    look_seconds: float = 0.5


def this_owner(job: str = "") -> Owner:
    """The owner that stands for the current process."""
    return Owner(_machine(), os.getpid(), _start_of(os.getpid()) or "", job)


def is_gone(owner: Owner, me: Owner) -> bool:
    """Whether ``owner`` was a process of this machine that is no longer there; False where that cannot be said."""
    return owner.machine == me.machine and bool(owner.started) and _start_of(owner.process) != owner.started


class Lease:
    """The lease of this job. `is_lost` says whether another job took the results over, as after a long pause."""

    def __init__(self, folder: Folder, owner: Owner, timing: Timing) -> None:
        self.name = f"{LEASES}/{uuid.uuid4().hex}.json"
        self._folder, self._owner, self._timing = folder, owner, timing
        self._count, self._since = 0, datetime.now(UTC).isoformat(timespec="seconds")
        self._over, self._lost = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._renew, daemon=True, name="apel-lease")

    @property
    def is_lost(self) -> bool:
        """Whether nothing may be written any more."""
        return self._lost.is_set()

    def want(self) -> None:
        """Give a sign of life before holding."""
        self._write("wanting")

    def hold(self) -> None:
        """Hold, and go on giving signs of life."""
        self._write("holding")
        for other in _others(self._folder, self.name).values():
            # Only after this process had stood still for so long that it was thought dead.
            if other.get("state") == "holding":
                raise BusyError(_busy_message(self._folder, other))
        self._thread.start()

    def release(self) -> None:
        """Give the results back."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
        with suppress(OSError):
            _forget(self._folder, self.name)

    def _write(self, state: Literal["wanting", "holding"]) -> None:
        self._count += 1
        content = {"state": state, "count": self._count, "since": self._since, "owner": asdict(self._owner)}
        self._folder.write(self.name, json.dumps(content).encode())

    def _renew(self) -> None:
        while not self._over.wait(self._timing.renew_seconds):
            # A store that does not answer for a while is no reason to end a job: whoever takes over says so here.
            with suppress(OSError):
                others = _others(self._folder, self.name).values()
                if not self._folder.exists(self.name) or any(other.get("state") == "holding" for other in others):
                    self._lost.set()
                    return
                self._write("holding")


@contextmanager
def lease(
    folder: Folder, owner: Owner, on_wait: Callable[[str], None], timing: Timing | None = None
) -> Iterator[Lease]:
    """Hold the results in ``folder`` for as long as the body runs.

    ``on_wait`` is told where it has to wait to see whether another job is alive.

    Raises
    ------
    BusyError
        If another job holds them.
    OSError
        If the folder cannot be written to.
    """
    timing = timing or Timing()
    held = Lease(folder, owner, timing)
    try:
        _outlast_others(folder, held, owner, timing, on_wait)
        held.hold()
        yield held
    finally:
        held.release()


def _outlast_others(folder: Folder, mine: Lease, me: Owner, timing: Timing, on_wait: Callable[[str], None]) -> None:
    """Return once no other lease is alive; see the protocol above."""
    watch = _Watch(me, timing.dead_seconds)
    told = False
    while True:
        mine.want()
        others = _others(folder, mine.name)
        states = {name: watch.look(name, other, time.monotonic()) for name, other in others.items()}
        for name, state in states.items():
            if state == "dead":
                _forget(folder, name)
            elif state == "alive" and (others[name].get("state") == "holding" or name < mine.name):
                raise BusyError(_busy_message(folder, others[name]))
        unsure = [others[name] for name, state in states.items() if state == "unsure"]
        if unsure and not told:
            told = True
            who = _owner(unsure[0])
            on_wait(f"waiting up to {timing.dead_seconds:.0f} s to see whether {who} is still computing these results")
        if all(state == "dead" for state in states.values()):
            return
        time.sleep(timing.look_seconds)


class _Watch:
    """What is known of other leases from looking at them several times."""

    def __init__(self, me: Owner, dead_seconds: float) -> None:
        self._me, self._dead_seconds = me, dead_seconds
        self._first: dict[str, tuple[Any, float]] = {}

    def look(self, name: str, other: dict[str, Any], now: float) -> Literal["alive", "dead", "unsure"]:
        """Whether a lease's job is alive; ``now`` in seconds of a monotonic clock."""
        owner = _owner(other)
        if owner.machine == self._me.machine and owner.started:
            return "dead" if is_gone(owner, self._me) else "alive"
        count, since = self._first.setdefault(name, (other.get("count"), now))
        if other.get("count") != count:
            return "alive"
        return "dead" if now - since > self._dead_seconds else "unsure"


def _busy_message(folder: Folder, other: dict[str, Any]) -> str:
    return (
        f"{folder.location()}: found results that {_owner(other)} has been computing since {other.get('since')}, "
        "expected none at work on them: wait for it, or stop it; two jobs at once would store runs twice"
    )


def _forget(folder: Folder, name: str) -> None:
    """Delete a lease, and what its job was writing of it when it was killed, or when the storage went away."""
    leases, file = folder.sub(LEASES), name.rpartition("/")[2]
    for temporary in leases.temporary_names():
        if temporary.startswith(f".{file}."):
            leases.delete(temporary)
    folder.delete(name)


def _others(folder: Folder, mine: str) -> dict[str, dict[str, Any]]:
    """All leases but one, by name."""
    return {name: other for name, other in _leases(folder).items() if name != mine}


def _leases(folder: Folder) -> dict[str, dict[str, Any]]:
    """All leases by name; one that vanishes while it is read is none, nor is what is no JSON object."""
    found = {}
    for name in folder.names(LEASES):
        with suppress(FileNotFoundError, ValueError, RecursionError):
            lease = json.loads(folder.read(f"{LEASES}/{name}"))
            if isinstance(lease, dict):
                found[f"{LEASES}/{name}"] = lease
    return found


def _owner(lease: dict[str, Any]) -> Owner:
    """Whose it is; fields that another version writes are passed over. One that does not say is nobody's here: whether
    it is alive is seen by its counter.
    """
    said = lease.get("owner")
    said = said if isinstance(said, dict) else {}
    machine, started, job = (
        value if isinstance(value := said.get(name), str) else "" for name in ("machine", "started", "job")
    )
    process = said.get("process")
    return Owner(machine, process if isinstance(process, int) else 0, started, job)


def _machine() -> str:
    """Host name and process namespace: two containers of one host may have the same process numbers."""
    namespace = Path("/proc/self/ns/pid")
    return f"{socket.gethostname()}/{namespace.readlink()}" if namespace.is_symlink() else socket.gethostname()


def _start_of(process: int) -> str | None:
    """When a process of this machine began, in the kernel's own count; None where there is none or no /proc."""
    try:
        # The second field, the program's name, is in brackets and may hold spaces.
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return None
