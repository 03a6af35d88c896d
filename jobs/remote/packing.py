"""The cluster's part of fetching results: pack them where the dashboard serves them, for as long as they are read."""

from __future__ import annotations

import io
import tarfile
import time
from collections.abc import Callable
from pathlib import Path

from jobs.progress.status_file import replace_json, status_file_name
from jobs.results.lease import LEASES
from jobs.results.storage import Folder

NOT_FETCHED = ("checkpoints", LEASES, "damaged", "spilled")
"""What only the job itself needs, and what is no result."""
_MOST_SECONDS = 3600.0


def archive_name(job: str) -> str:
    """The archive's name, relative to the folder of the session's logs."""
    return f"apel-{job}.tar"


def serve_archive(results: str, job: str, log_folder: Path, stopping: Callable[[], bool]) -> None:
    """Pack a results folder, say so, and delete the archive once ``stopping()`` says that it was read."""
    archive, status = log_folder / archive_name(job), log_folder / status_file_name(job)
    try:
        write_archive(Folder(results), archive)
        replace_json(status, {"bytes": archive.stat().st_size})
        deadline = time.monotonic() + _MOST_SECONDS
        while not stopping() and time.monotonic() < deadline:
            time.sleep(0.1)
    finally:
        archive.unlink(missing_ok=True)
        status.unlink(missing_ok=True)


def write_archive(folder: Folder, archive: Path) -> None:
    """Pack all files of results.

    Raises
    ------
    FileNotFoundError
        If there are none.
    """
    names = [name for name in folder.names() if name.split("/")[0] not in NOT_FETCHED]
    if not names:
        message = f"{folder.location()}: found no results"
        raise FileNotFoundError(message)
    with tarfile.open(archive, "w") as files:
        for name in names:
            content = folder.read(name)
            info = tarfile.TarInfo(name)
            info.size = len(content)
            files.addfile(info, io.BytesIO(content))
