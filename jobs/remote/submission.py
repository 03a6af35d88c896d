"""Experiments as jobs of a Ray cluster, through its Jobs API: submit, watch, stop, go on, fetch.

The client needs nothing but the address of the cluster's dashboard, and its token in ``RAY_AUTH_TOKEN``,
``RAY_AUTH_TOKEN_PATH`` or ``~/.ray/auth_token``.
"""

from __future__ import annotations

import asyncio
import json
import shlex
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ray.job_submission import JobDetails, JobStatus, JobSubmissionClient

from cluster.errors import ClusterError
from jobs.lease import BusyError
from jobs.manifest import versions
from jobs.remote import DEFAULT_ADDRESS
from jobs.remote.connection import connected, read_log_file
from jobs.remote.package import EXPERIMENT_FILE, local_modules, named_modules, refuse_credentials, write_package
from jobs.remote.records import Draft, Record, copy_package, drafted, read_record
from jobs.spec import Experiment
from jobs.status_file import status_file_name
from jobs.yaml_source import SpecError

_MARK = "apel"
"""Every job that is submitted here has metadata of this name."""
_STOP_SECONDS = 120
_POLL_SECONDS = 0.5
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
        What the job says of itself (`jobs.status_file`); None before it has joined the cluster.
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


@dataclass(frozen=True)
class Job:
    """A submitted job; it may have been submitted by anybody."""

    id: str
    address: str
    was_running: bool = False
    """It was there already when the same was submitted again."""

    def status(self) -> Status:
        """How it is, as the job itself says.

        Raises
        ------
        ClusterError
            If the cluster cannot be asked, or knows no such job.
        """
        with connected(self.address) as client:
            return _status(client, _details(client, self.id))

    def logs(self) -> str:
        """What it has printed so far."""
        with connected(self.address) as client:
            _details(client, self.id)
            return str(client.get_job_logs(self.id))

    def follow(self) -> Iterator[str]:
        """What it prints, piece by piece, until it ends."""
        with connected(self.address) as client:
            _details(client, self.id)
            yield from _each(client.tail_job_logs(self.id))

    def wait(self, on_status: Callable[[Status], None] = lambda _: None) -> Status:
        """Wait until it has ended."""
        while True:
            status = self.status()
            on_status(status)
            if status.is_over:
                return status
            time.sleep(_POLL_SECONDS)

    def stop(self) -> Status:
        """Let it write checkpoints and end; waits until it has.

        A job that does not end within two minutes is killed, which costs the work since its last checkpoint.
        """
        with connected(self.address) as client:
            _details(client, self.id)
            client.stop_job(self.id)
        return self.wait()

    def resume(self, address: str | None = None) -> Job:
        """Submit it again, here or at another address: it goes on where it stopped.

        Raises
        ------
        SpecError
            If it was not submitted from this machine.
        """
        record = read_record(self.id)
        record = replace(record, address=address or self.address)
        return _submitted(record, lambda package: copy_package(record.job, package))

    def fetch(self, destination: str | Path) -> Path:
        """Copy its results, whatever there is by now, below ``destination``; returns the experiment's folder there.

        Raises
        ------
        ClusterError
            If the job has not said yet where its results lie, or they cannot be read.
        """
        from jobs.remote.fetching import fetch

        return fetch(self, Path(destination))


def submit(
    experiment: Experiment,
    *,
    address: str = DEFAULT_ADDRESS,
    options: Sequence[str] = (),
    results: str | None = None,
    modules: Sequence[str] = (),
    folder: str | Path = ".",
) -> Job:
    """Submit an experiment to a Ray cluster; where it is running there already, that job is returned.

    Parameters
    ----------
    experiment:
        See `jobs.spec_files.load_experiment`.
    address:
        Of the cluster's dashboard, ``http://HOST:8265``.
    options:
        More words for `apel run`, such as ``("--placement", "packed")``.
    results:
        Path or URI that all nodes of the cluster can write to; None for what the cluster's ``APEL_RESULTS`` says.
    modules:
        Names of modules in ``folder`` to be sent, beside those that the experiment names and what these import.
    folder:
        Where the user's own modules lie.

    Raises
    ------
    SpecError
        If a field, a module, or the place for the results cannot be right.
    BusyError
        If the same experiment is running there with other options.
    ClusterError
        If the cluster cannot be reached.
    """
    words = [*options, *(("--results", _checked(results)) if results else ())]
    found = local_modules([*named_modules(experiment), *modules], Path(folder))
    missing = set(modules) - {path.stem for path in found}
    if missing:
        message = f"--module: found no module {sorted(missing)[0]!r} in {Path(folder).resolve()}"
        raise SpecError(message)
    record = Record("", address, experiment.name, experiment.identity, tuple(words))
    return _submitted(record, lambda package: write_package(experiment, found, package))


def list_jobs(address: str = DEFAULT_ADDRESS) -> list[Status]:
    """All jobs of this program that the cluster knows, the latest first."""
    with connected(address) as client:
        return [_status(client, details) for details in _ours(client)]


def _checked(results: str) -> str:
    """A place for results that every node understands."""
    refuse_credentials(results)
    if "://" not in results and not results.startswith("/"):
        message = f"--results: found {results!r}, expected an absolute path on the cluster's nodes, or a URI"
        raise SpecError(message)
    return results


def _submitted(record: Record, pack: Callable[[Path], None]) -> Job:
    """Submit under an id that Ray will not give twice, so that of two submissions at once one is second."""
    with connected(record.address) as client:
        while True:
            same = [job for job in _ours(client) if (job.metadata or {}).get("identity") == record.identity]
            for details in same:
                if _STATES[details.status] in ("pending", "running") and _same_place(details, record):
                    return _attached(details, record)
            named = replace(record, job=f"{record.experiment}-{record.identity}-{_next_number(same)}")
            with drafted(named, pack) as draft:
                if _is_accepted(client, draft):
                    draft.keep()
                    return Job(named.job, record.address)


def _is_accepted(client: JobSubmissionClient, draft: Draft) -> bool:
    """Submit a job; False if somebody else's has got its id in the meantime."""
    try:
        client.submit_job(
            entrypoint=shlex.join(("apel", "run", EXPERIMENT_FILE, *draft.record.options)),
            submission_id=draft.record.job,
            runtime_env={
                "working_dir": str(draft.package),
                # Time for the checkpoints; Ray's own limit is three seconds.
                "env_vars": {"RAY_JOB_STOP_WAIT_TIME_S": str(_STOP_SECONDS)},
            },
            metadata=_metadata(draft.record),
        )
    except RuntimeError as error:
        if "already exists" in str(error):
            return False
        raise
    return True


def _metadata(record: Record) -> dict[str, str]:
    return {
        _MARK: versions()["apel"],
        "job_name": record.experiment,  # what the dashboard calls it
        "experiment": record.experiment,
        "identity": record.identity,
        "options": shlex.join(record.options),
    }


def _attached(details: JobDetails, record: Record) -> Job:
    if _options_of(details) != shlex.join(record.options):
        message = (
            f"found the job {details.submission_id} at work on this experiment with the options "
            f"{_options_of(details)!r}, expected none, or the same options: stop it, or wait for it"
        )
        raise BusyError(message)
    return Job(str(details.submission_id), record.address, was_running=True)


def _options_of(details: JobDetails) -> str:
    return (details.metadata or {}).get("options", "")


def _same_place(details: JobDetails, record: Record) -> bool:
    return _results_of(shlex.split(_options_of(details))) == _results_of(record.options)


def _results_of(options: Sequence[str]) -> str:
    words = list(options)
    return words[words.index("--results") + 1] if "--results" in words else ""


def _next_number(same: Sequence[JobDetails]) -> int:
    numbers = [int(str(details.submission_id).rpartition("-")[2]) for details in same]
    return max(numbers, default=0) + 1


def _ours(client: JobSubmissionClient) -> list[JobDetails]:
    """The jobs of this program, the latest first."""
    jobs = [job for job in client.list_jobs() if job.submission_id and _is_ours(job)]
    return sorted(jobs, key=lambda job: -(job.start_time or 0))


def _is_ours(job: JobDetails) -> bool:
    """Submitted by this program, or by ``ray job submit -- apel run …``."""
    return _MARK in (job.metadata or {}) or "apel run" in job.entrypoint


def _details(client: JobSubmissionClient, job: str) -> JobDetails:
    try:
        return client.get_job_info(job)
    except RuntimeError as error:
        if "404" not in str(error):
            raise
        message = f"found no job {job!r} on this cluster, expected one that `apel jobs` shows"
        raise ClusterError(message) from error


def _status(client: JobSubmissionClient, details: JobDetails) -> Status:
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
        time.sleep(_POLL_SECONDS * attempt)
        content = b"".join(read_log_file(client, details.driver_node_id, name)) if details.driver_node_id else b""
        with suppress(ValueError):
            found: dict[str, Any] = json.loads(content)
            return found
    return None


def _each(pieces: AsyncIterator[str]) -> Iterator[str]:
    """The same without ``await``."""
    loop = asyncio.new_event_loop()
    try:
        while True:
            try:
                yield loop.run_until_complete(anext(pieces))
            except StopAsyncIteration:
                return
    finally:
        loop.close()
