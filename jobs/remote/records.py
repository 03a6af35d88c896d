"""What this machine remembers of the jobs that were submitted from it: enough to submit them again.

A Ray cluster forgets its jobs, and what was sent with them, when its head restarts.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from jobs.remote.package import write_package
from jobs.spec import Experiment
from jobs.yaml_source import SpecError


@dataclass(frozen=True)
class Record:
    """A submitted job.

    Attributes
    ----------
    job:
        Its id.
    address:
        Of the cluster's dashboard.
    experiment, identity:
        What it runs.
    options:
        The words after ``apel run experiment.yaml``.
    """

    job: str
    address: str
    experiment: str
    identity: str
    options: tuple[str, ...]


def records_folder() -> Path:
    """Where the records lie: ``$XDG_STATE_HOME/apel/jobs``, by default below ``~/.local/state``."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "apel" / "jobs"


def package_folder(job: str) -> Path:
    """What was sent with a job."""
    return records_folder() / job / "package"


def new_record(record: Record, experiment: Experiment, modules: Sequence[Path]) -> Path:
    """Remember a job and what is to be sent with it; returns the folder to be sent."""
    folder = records_folder() / record.job
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True, mode=0o700)
    write_package(experiment, modules, package_folder(record.job))
    _write(folder, record)
    return package_folder(record.job)


def copied_record(record: Record, source: Record) -> Path:
    """Remember a job that sends what another one sent; returns the folder to be sent."""
    folder = records_folder() / record.job
    if record.job != source.job:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(records_folder() / source.job, folder)
    _write(folder, record)
    return package_folder(record.job)


def read_record(job: str) -> Record:
    """What is remembered of a job.

    Raises
    ------
    SpecError
        If it was not submitted from this machine.
    """
    path = records_folder() / job / "job.json"
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        message = (
            f"found no record of the job {job!r} on this machine ({path}), expected one that was submitted from here: "
            "submit its experiment again, which goes on where the job stopped"
        )
        raise SpecError(message) from error
    return Record(**{**stored, "options": tuple(stored["options"])})


def _write(folder: Path, record: Record) -> None:
    (folder / "job.json").write_text(json.dumps(asdict(record)), encoding="utf-8")
