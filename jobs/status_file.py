"""The progress of a job as a small JSON file among the logs of its Ray session, where the dashboard serves it.

Ray's Jobs API has no place for what a job wants to say of itself, and its log is for people. The file is replaced as a
whole, and stays as long as the session does, so that a job that is over can be asked too.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cluster.events import ShardEvent
from cluster.shard import Shard
from jobs.observers import Ending, Observer
from jobs.progress import JobProgress

_PAUSE_SECONDS = 0.5


def status_file_name(job: str) -> str:
    """Its name, relative to the folder of the session's logs."""
    return f"apel-{job}.json"


def replace_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a file that is seen whole or not at all."""
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(content))
    os.replace(temporary, path)  # noqa: PTH105 - the one that says that it replaces


class StatusFile(Observer):
    """Writes the file at most twice a second, and at the end.

    Attributes
    ----------
    about:
        What is said beside the progress: experiment, identity, where the results lie.
    """

    def __init__(self, job: str, about: Mapping[str, Any]) -> None:
        self._job, self._about = job, about
        self._path: Path | None = None
        self._progress: JobProgress | None = None
        self._began, self._since = time.monotonic(), datetime.now(UTC).isoformat(timespec="milliseconds")
        self._last = 0.0
        self._phases: dict[str, float] = {}
        self._message = ""

    def waiting(self, message: str) -> None:
        """Say why nothing moves."""
        self._message = message

    def joined(self, dashboard_url: str, num_cpus: int, log_folder: Path) -> None:
        """From now on there is a place for the file."""
        self._path = log_folder / status_file_name(self._job)
        self._mark("joined")
        self._write("running")

    def planned(self, progress: JobProgress) -> None:
        """Write what is to be done."""
        self._progress, self._message = progress, ""
        self._mark("planned")
        self._write("running")

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        """Write how far it has come, now and then."""
        self._mark("first_episode")
        if time.monotonic() - self._last >= _PAUSE_SECONDS:
            self._write("running")

    def ended(self, ending: Ending) -> None:
        """Write how it ended."""
        self._mark("ended")
        self._write(ending)

    def _mark(self, phase: str) -> None:
        self._phases.setdefault(phase, round(time.monotonic() - self._began, 3))

    def _write(self, state: str) -> None:
        if self._path is None:
            return
        self._last = time.monotonic()
        status = {
            "job": self._job,
            **self._about,
            "state": state,
            "message": self._message,
            "since": self._since,
            "seconds": round(self._last - self._began, 3),
            "phases": self._phases,
            **(self._progress.as_json() if self._progress else {"restarts": 0, "arms": {}}),
        }
        replace_json(self._path, status)
