"""What this machine remembers of the jobs that were submitted from it: enough to submit them again.

A Ray cluster forgets its jobs, and what was sent with them, when its head restarts.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from jobs.experiment.yaml_source import SpecError

_PACKAGE, _RECORD = "package", "job.json"


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
    runs, models:
        How many runs it plays, and which models it keeps; None of what older versions submitted.
    """

    job: str
    address: str
    experiment: str
    identity: str
    options: tuple[str, ...]
    runs: int | None = None
    models: str | None = None


def records_folder() -> Path:
    """Where the records lie: ``$XDG_STATE_HOME/apel/jobs``, by default below ``~/.local/state``."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "apel" / "jobs"


def package_folder(job: str) -> Path:
    """What was sent with a job."""
    return records_folder() / job / _PACKAGE


@dataclass(frozen=True)
class Draft:
    """A record of a job that the cluster has not accepted yet; see `drafted`."""

    record: Record
    folder: Path

    @property
    def package(self) -> Path:
        """The folder to be sent."""
        return self.folder / _PACKAGE

    def keep(self) -> None:
        """Remember the job from now on; what was remembered of another cluster's job of the same id makes way."""
        kept = records_folder() / self.record.job
        with _locked():
            shutil.rmtree(kept, ignore_errors=True)
            self.folder.rename(kept)


@contextmanager
def drafted(record: Record, pack: Callable[[Path], None]) -> Iterator[Draft]:
    """A job that is about to be submitted, with what ``pack(folder)`` packs; forgotten at the end unless it was kept.

    It lies in a folder of its own: of two processes that submit the same at once, under the same id, neither may touch
    what the other one is sending, and the record is that of the one whose job it became.
    """
    records_folder().mkdir(parents=True, exist_ok=True)
    draft = Draft(record, Path(tempfile.mkdtemp(prefix=f".{record.job}.", dir=records_folder())))
    try:
        pack(draft.package)
        (draft.folder / _RECORD).write_text(json.dumps(asdict(record)), encoding="utf-8")
        yield draft
    finally:
        shutil.rmtree(draft.folder, ignore_errors=True)


def copy_package(job: str, target: Path) -> None:
    """Copy what was sent with a job to ``target``, which must not exist."""
    with _locked():
        shutil.copytree(package_folder(job), target)


def read_record(job: str) -> Record:
    """What is remembered of a job.

    Raises
    ------
    SpecError
        If it was not submitted from this machine.
    """
    path = records_folder() / job / _RECORD
    try:
        with _locked():
            stored = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        message = (
            f"found no record of the job {job!r} on this machine ({path}), expected one that was submitted from here: "
            "submit its experiment again, which resumes where the job stopped"
        )
        raise SpecError(message) from error
    return Record(**{**stored, "options": tuple(stored["options"])})


@contextmanager
def _locked() -> Iterator[None]:
    """No other process replaces a record, which takes two steps, while the body runs; so it finds each one whole."""
    with (records_folder() / ".lock").open("w") as file:
        # Some file systems know no locks. There the two steps are all that is left to chance.
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
