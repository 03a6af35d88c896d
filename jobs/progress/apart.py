"""Tells a `jobs.progress.job_observer.JobObserver` in a thread of its own, so that no job waits for a slow one."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping

from apel.run.user_code import culprit_of, in_a_line, place_of
from cluster.events import ShardEvent
from cluster.shard import Shard
from jobs.progress.job_observer import JobInfo, JobObserver
from jobs.progress.observers import Ending, Observer
from jobs.progress.progress import ArmProgress, JobProgress

_PAUSE_SECONDS = 1.0
_END_SECONDS = 60.0


class Apart(Observer):
    """One thread, which is told the latest there is: what an observer was too slow for is left out.

    Parameters
    ----------
    log:
        What the user calls it.
    observer:
        Who is told.
    job:
        Of which job.
    say:
        Tells the user, from the thread of the job, what the observer raised first.
    """

    def __init__(self, log: str, observer: JobObserver, job: JobInfo, say: Callable[[str], None]) -> None:
        self._log, self._observer, self._job, self._say = log, observer, job, say
        self._thread: threading.Thread | None = None
        self._news = threading.Condition()
        self._latest: Mapping[str, ArmProgress] | None = None
        self._ending: Ending | None = None
        self._trouble = ""
        self._has_said = False
        self._progress: JobProgress | None = None
        self._last = 0.0

    def planned(self, progress: JobProgress) -> None:
        """Begin, once there is something to play."""
        self._progress = progress
        if progress.num_shards and self._thread is None:
            self._thread = threading.Thread(target=self._tell, daemon=True, name=f"apel-log-{self._log}")
            self._thread.start()

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        """Hand on how far it has come, now and then."""
        if time.monotonic() - self._last >= _PAUSE_SECONDS:
            self._hand_on()
            self._say_trouble()

    def ended(self, ending: Ending) -> None:
        """Hand on the end, and wait until it is told, but not for ever."""
        if self._thread is None:
            return
        self._hand_on(ending)
        self._thread.join(_END_SECONDS)
        if self._thread.is_alive():
            self._trouble = f"was not done within {_END_SECONDS:.0f} s after the job; what it had not written is lost"
            self._has_said = False
        self._say_trouble()

    def _hand_on(self, ending: Ending | None = None) -> None:
        self._last = time.monotonic()
        with self._news:
            self._latest, self._ending = self._progress.arms() if self._progress else {}, ending
            self._news.notify()

    def _say_trouble(self) -> None:
        if self._trouble and not self._has_said:
            self._has_said = True
            self._say(f"--log {self._log}: {self._trouble}")

    def _tell(self) -> None:
        """What the thread does."""
        if not self._is_told("begin", lambda: self._observer.begin(self._job)):
            return
        ending: Ending | None = None
        while ending is None:
            with self._news:
                self._news.wait_for(lambda: self._latest is not None)
                arms, ending = self._latest or {}, self._ending
                self._latest = None
            self._is_told("progress", lambda arms=arms: self._observer.progress(arms))  # type: ignore[misc]
        self._is_told("end", lambda: self._observer.end(ending))

    def _is_told(self, what: str, tell: Callable[[], None]) -> bool:
        """Whether the observer took it without raising anything."""
        try:
            tell()
        except BaseException as error:  # noqa: BLE001 - whatever a user's code raises, SystemExit too, must not end a job
            culprit = culprit_of(error)
            place = place_of(culprit)
            where = f" ({place})" if place else ""
            self._trouble = self._trouble or f"{what} raised {in_a_line(culprit)}{where}; the job continues"
            return False
        return True
