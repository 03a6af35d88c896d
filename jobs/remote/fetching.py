"""The results of a submitted job, brought to the machine that asks.

Where they lie in a store that this machine reaches too (``s3://…``), they are copied from there. A path is one of the
cluster's: a small job packs what is there into one file among the logs of the Ray session, which the dashboard serves
to whoever has the token; it is unpacked here, and deleted there.
"""

from __future__ import annotations

import json
import shlex
import tarfile
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from ray.job_submission import JobSubmissionClient

from cluster.errors import ClusterError
from jobs.progress.status_file import status_file_name
from jobs.remote.connection import connected, read_log_file
from jobs.remote.packing import NOT_FETCHED, archive_name
from jobs.remote.status import Status
from jobs.results.storage import Folder, reached

_READY_SECONDS, _DOWNLOAD_SECONDS, _POLL_SECONDS = 300.0, 3600, 0.3


def fetch_results(address: str, status: Status, destination: Path) -> Path:
    """Copy the results of a job of the cluster at ``address``; see `jobs.remote.job.Job.fetch`."""
    if status.progress is None:
        message = f"{status.job}: found nothing to fetch yet: the job has not said where its results lie"
        raise ClusterError(message)
    progress = status.progress
    target = destination / _own_name(progress["experiment"]) / _own_name(progress["identity"])
    if "://" in progress["results"] and not progress["results"].startswith("file:"):
        _copy(reached(progress["results"]), target)
    else:
        _fetch_through(address, status.job, progress["results"], target)
    return target


def _own_name(name: str) -> str:
    """The name of a folder within another one; what a job says of itself is as good as whoever submitted it.

    Raises
    ------
    ClusterError
        If it leads elsewhere.
    """
    if name in ("", ".", "..") or "/" in name or "\0" in name:
        message = f"found a job that calls its results {name!r}, expected the name of a folder: nothing is fetched"
        raise ClusterError(message)
    return name


def _copy(source: Folder, target: Path) -> None:
    for name in source.names():
        parts = [_own_name(part) for part in name.split("/")]
        if parts[0] not in NOT_FETCHED:
            path = target.joinpath(*parts)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(source.read(name))


def _fetch_through(address: str, job: str, results: str, target: Path) -> None:
    with _packed(address, results) as (client, node, name, size), tempfile.TemporaryFile() as archive:
        for piece in read_log_file(client, node, name, _DOWNLOAD_SECONDS):
            archive.write(piece)
        if archive.tell() != size:
            message = f"{job}: found {archive.tell()} bytes of {size}: the connection broke off; fetch again"
            raise ClusterError(message)
        archive.seek(0)
        _unpack(archive, target)


def _unpack(archive: IO[bytes], target: Path) -> None:
    target.mkdir(parents=True, exist_ok=True)
    with tarfile.open(fileobj=archive) as files:
        files.extractall(target, filter="data")


@contextmanager
def _packed(address: str, results: str) -> Iterator[tuple[JobSubmissionClient, str, str, int]]:
    """Client, node, name and size of an archive that is there for as long as the body runs."""
    helper = f"fetch-{uuid.uuid4().hex[:12]}"
    with connected(address) as client:
        client.submit_job(entrypoint=shlex.join(("apel", "pack", results)), submission_id=helper)
        try:
            node, size = _wait_for_archive(client, helper)
            yield client, node, archive_name(helper), size
        finally:
            with suppress(RuntimeError):
                client.stop_job(helper)
                _wait_for_end(client, helper)
                client.delete_job(helper)


def _wait_for_archive(client: JobSubmissionClient, helper: str) -> tuple[str, int]:
    deadline = time.monotonic() + _READY_SECONDS
    while time.monotonic() < deadline:
        details: Any = client.get_job_info(helper)
        if details.driver_node_id:
            content = b"".join(read_log_file(client, details.driver_node_id, status_file_name(helper)))
            with suppress(ValueError):
                return details.driver_node_id, int(json.loads(content)["bytes"])
        if details.status.is_terminal():
            message = f"the results could not be packed on the cluster: {client.get_job_logs(helper).strip()}"
            raise ClusterError(message)
        time.sleep(_POLL_SECONDS)
    message = f"the results were not packed within {_READY_SECONDS:.0f} s; see the job {helper} on the dashboard"
    raise ClusterError(message)


def _wait_for_end(client: JobSubmissionClient, helper: str) -> None:
    deadline = time.monotonic() + 30.0
    while not client.get_job_status(helper).is_terminal() and time.monotonic() < deadline:
        time.sleep(_POLL_SECONDS)
