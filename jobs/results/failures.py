"""What failed runs leave behind: ``failures/``, with the whole traceback of the first run of each distinct error."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict

from cluster.errors import RunFailure
from jobs.experiment.plan import RunKey
from jobs.results.storage import Folder

FAILURES = "failures"
_INDEX = f"{FAILURES}/index.json"
_MOST_FILES = 50


class FailureFiles:
    """The folder, written anew by every session of work: runs that failed are played again by each."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        self._runs: list[dict[str, object]] = []
        self._names: set[str] = set()

    def forget(self) -> None:
        """Delete what an earlier session wrote."""
        self._folder.delete_folder(FAILURES)

    def add(self, failures: Sequence[RunFailure]) -> None:
        """Write what is new."""
        for failure in failures:
            name = _name(failure)
            if name not in self._names and len(self._names) < _MOST_FILES:
                self._names.add(name)
                self._folder.write(f"{FAILURES}/{name}", _text(failure).encode(errors="replace"))
            about = {key: value for key, value in asdict(failure).items() if key != "trace"}
            self._runs.append({**about, "file": name if name in self._names else ""})
        if failures:
            self._folder.write(_INDEX, json.dumps(self._runs, indent=1).encode())


def failed_runs(folder: Folder) -> list[RunKey]:
    """The runs that failed in the last session of work, in the order in which they did."""
    with suppress(FileNotFoundError, ValueError, KeyError, TypeError):
        return [(run["arm"], run["sweep"], int(run["run_index"])) for run in json.loads(folder.read(_INDEX))]
    return []


def _name(failure: RunFailure) -> str:
    """The same for runs that failed in the same way: numbers in the error's text may differ."""
    kind = failure.error.partition(":")[0] if failure.place else failure.error
    return hashlib.sha256(repr((failure.part, failure.place, kind)).encode()).hexdigest()[:12] + ".txt"


def _text(failure: RunFailure) -> str:
    sweep = f" [{failure.sweep}]" if failure.sweep else ""
    lines = [f"{failure.arm}{sweep}: {failure.error}", f"at {failure.where()}"]
    if failure.place:
        lines.append(f"{f'the {failure.part}, ' if failure.part else ''}{failure.place}")
    return "\n".join((*lines, "", failure.trace))
