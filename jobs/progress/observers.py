"""Whoever wants to be told how a job goes on: terminal, status file, Prometheus, TensorBoard."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from cluster.events import ShardEvent
from cluster.shard import Shard
from jobs.progress.progress import JobProgress

Ending = Literal["done", "failed", "stopped", "broken"]
"""All runs are there; some runs failed; it was asked to stop; it broke off with an error."""


class Observer:
    """Told of what happens; this one does nothing."""

    def waiting(self, message: str) -> None:
        """The job cannot go on at the moment; the message says why."""

    def noted(self, message: str) -> None:
        """The user should know this, though the job goes on."""

    def compiling(self) -> None:
        """Compiled functions are made, once per installation."""

    def joined(self, dashboard_url: str, num_cpus: int, log_folder: Path) -> None:
        """The cluster is there."""

    def planned(self, progress: JobProgress) -> None:
        """What is to be done is known."""

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        """A shard went on; ``progress`` has taken it in."""

    def ended(self, ending: Ending) -> None:
        """The job is over."""


NO_OBSERVER = Observer()


@contextmanager
def told_if_it_lasts(tell: Callable[[], None], seconds: float = 2.0) -> Iterator[None]:
    """Call ``tell``, in a thread of its own, once the body has run for so long; how long it will take is not known."""
    timer = threading.Timer(seconds, tell)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


class Observers(Observer):
    """Several observers, told one after the other."""

    def __init__(self, observers: Sequence[Observer]) -> None:
        self._observers = observers

    def waiting(self, message: str) -> None:
        """See `Observer`."""
        for observer in self._observers:
            observer.waiting(message)

    def noted(self, message: str) -> None:
        """See `Observer`."""
        for observer in self._observers:
            observer.noted(message)

    def compiling(self) -> None:
        """See `Observer`."""
        for observer in self._observers:
            observer.compiling()

    def joined(self, dashboard_url: str, num_cpus: int, log_folder: Path) -> None:
        """See `Observer`."""
        for observer in self._observers:
            observer.joined(dashboard_url, num_cpus, log_folder)

    def planned(self, progress: JobProgress) -> None:
        """See `Observer`."""
        for observer in self._observers:
            observer.planned(progress)

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        """See `Observer`."""
        for observer in self._observers:
            observer.progressed(shard, event, progress)

    def ended(self, ending: Ending) -> None:
        """See `Observer`."""
        for observer in self._observers:
            observer.ended(ending)
