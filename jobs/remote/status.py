"""How the jobs of a cluster are: what Ray's Jobs API knows of them, and what they say of themselves."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from ray.job_submission import JobDetails, JobStatus, JobSubmissionClient

from cluster.errors import ClusterError
from jobs.progress.status_file import read_status, status_file_name
from jobs.remote import DEFAULT_ADDRESS
from jobs.remote.connection import connected, read_log_file

MARK = "apel"
"""Every job that this program submits has metadata of this name."""
_PAUSE_SECONDS = 0.5
_TRIES = 3
_STATES = {
    JobStatus.PENDING: "pending",
    JobStatus.RUNNING: "running",
    JobStatus.STOPPED: "stopped",
    JobStatus.SUCCEEDED: "done",
    JobStatus.FAILED: "failed",
}


@dataclass(frozen=True)
class Status:
    """How a job is.

    Attributes
    ----------
    state:
        ``pending``, ``running``, ``stopped``, ``done`` or ``failed``.
    message:
        Why it waits, or how it failed; empty where there is nothing to say.
    exit_code:
        That of `apel run`; None before its end.
    progress:
        What the job says of itself (`jobs.progress.status_file`); None before it has joined the cluster.
    """

    job: str
    state: str
    message: str
    exit_code: int | None
    progress: dict[str, Any] | None

    @property
    def is_over(self) -> bool:
        """Whether it has ended, in whatever way."""
        return self.state not in ("pending", "running")


def list_jobs(address: str = DEFAULT_ADDRESS) -> list[Status]:
    """All jobs of this program that the cluster knows, the latest first."""
    with connected(address) as client:
        return [status_of(client, details) for details in our_jobs(client)]


def our_jobs(client: JobSubmissionClient) -> list[JobDetails]:
    """What Ray knows of the jobs of this program, the latest first."""
    jobs = [job for job in client.list_jobs() if job.submission_id and _is_ours(job)]
    return sorted(jobs, key=lambda job: -(job.start_time or 0))


def _is_ours(job: JobDetails) -> bool:
    """Submitted by this program, or by ``ray job submit -- apel run …``."""
    return MARK in (job.metadata or {}) or "apel run" in job.entrypoint


def details_of(client: JobSubmissionClient, job: str) -> JobDetails:
    """What Ray knows of a job.

    Raises
    ------
    ClusterError
        If it knows no such job.
    """
    try:
        return client.get_job_info(job)
    except RuntimeError as error:
        if "404" not in str(error):
            raise
        message = f"found no job {job!r} on this cluster, expected one that `apel jobs` shows"
        raise ClusterError(message) from error


def status_of(client: JobSubmissionClient, details: JobDetails) -> Status:
    """What Ray knows of a job, and what it says of itself, put together."""
    progress = _progress(client, details)
    state = _STATES[details.status]
    message = (progress or {}).get("message", "")
    if state == "failed" and details.message:
        message = details.message
    return Status(str(details.submission_id), state, message, details.driver_exit_code, progress)


def _progress(client: JobSubmissionClient, details: JobDetails) -> dict[str, Any] | None:
    name = status_file_name(str(details.submission_id))
    # A job that is over has its file; a busy node may fail to serve it in time.
    for attempt in range(_TRIES if details.status.is_terminal() else 1):
        time.sleep(_PAUSE_SECONDS * attempt)
        content = b"".join(read_log_file(client, details.driver_node_id, name)) if details.driver_node_id else b""
        if (found := read_status(content)) is not None:
            return found
    return None
