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
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from cluster.events import ShardEvent
from cluster.shard import Shard
from jobs.progress.observers import Ending, Observer
from jobs.progress.pace import Pace
from jobs.progress.progress import JobProgress

_PAUSE_SECONDS = 0.5


def status_file_name(job: str) -> str:
    """Its name, relative to the folder of the session's logs."""
    return f"apel-{job}.json"


_Count = Annotated[int, Field(ge=0, lt=2**63)]


class _Arm(BaseModel):
    """What is shown of an arm; see `jobs.progress.progress.ArmProgress`."""

    model_config = ConfigDict(strict=True)

    runs_planned: _Count
    runs_done: _Count
    runs_failed: _Count
    episodes: _Count
    episodes_planned: _Count
    steps: _Count
    mean_return: float | None
    mean_train_time: float | None
    selection_share: dict[str, float]


class _Status(BaseModel):
    """What is read of the file."""

    model_config = ConfigDict(strict=True)

    experiment: str
    identity: str
    results: str
    message: str
    seconds: float
    seconds_left: Annotated[float, Field(ge=0, lt=1e12)] | None = None
    arms: dict[str, _Arm]


def read_status(content: bytes) -> dict[str, Any] | None:
    """What the file says; None where it is none, or not whole: whoever submitted the job may have written anything."""
    try:
        found: dict[str, Any] = json.loads(content)
        _Status.model_validate(found)
    except (ValueError, RecursionError):
        return None
    return found


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
        self._pace = Pace()
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
        seconds = self._last - self._began
        status = {
            "job": self._job,
            **self._about,
            "state": state,
            "message": self._message,
            "since": self._since,
            "seconds": round(seconds, 3),
            "seconds_left": self._left(seconds) if state == "running" else None,
            "phases": self._phases,
            **(self._progress.as_json() if self._progress else {"restarts": 0, "arms": {}}),
        }
        replace_json(self._path, status)

    def _left(self, seconds: float) -> float | None:
        """About how long it may still take; None as long as nothing is known."""
        if self._progress is None:
            return None
        arms = self._progress.as_json()["arms"].values()
        done, planned = (sum(arm[name] for arm in arms) for name in ("episodes", "episodes_planned"))
        left = self._pace.left(seconds, done, planned)
        return None if left is None else round(left, 1)
