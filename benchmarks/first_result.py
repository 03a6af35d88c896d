"""From an empty folder to the first result: where the time goes. Needs git, make, Python's headers and a package index.

::

    python -m benchmarks.first_result fe37649 HEAD --repetitions 2

Each revision is cloned into an empty folder, and ``make run`` is called there, the revisions in turn. Packages that pip
has fetched once come from its cache: the first repetition finds it as it is, the others find it warm. Stages end with
lines that the commands print. Processor time is that of all processes below this one, which adopts those whose parents
end, as Ray's do; it is read twice a second, so that what a process does in its last moments is missed.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).parent.parent
STAGES = (
    ("compiling", "the command is imported, the experiment checked"),
    ("Ray with", "compiling"),
    ("runs in", "Ray's start, the job"),
    ("report.html", "tables, figures, report"),
)
_ADOPT_ORPHANS = 36
"""PR_SET_CHILD_SUBREAPER of Linux' prctl."""


def main() -> None:
    """Print as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("revisions", nargs="+")
    parser.add_argument("--repetitions", type=int, default=2)
    parser.add_argument("--python", default="python3")
    arguments = parser.parse_args()
    ctypes.CDLL(None).prctl(_ADOPT_ORPHANS, 1, 0, 0, 0)
    found: list[dict[str, Any]] = []
    for repetition in range(arguments.repetitions + 1):
        for revision in arguments.revisions:
            with tempfile.TemporaryDirectory() as name:
                one = {
                    "revision": revision,
                    "cache": "warm" if repetition else "as found",
                    **first_result(revision, Path(name), arguments),
                }
            print(json.dumps(one), flush=True)
            found.append(one)
    stored = ROOT / "benchmarks" / "results" / "first_result.json"
    stored.write_text(json.dumps({"python": arguments.python, "all": found}, indent=1) + "\n")


def first_result(revision: str, folder: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """Seconds of wall and processor time of each stage, and what is installed."""
    subprocess.run(["git", "clone", "--quiet", ROOT, folder / "apel"], check=True)
    here = folder / "apel"
    subprocess.run(["git", "checkout", "--quiet", revision], cwd=here, check=True)
    environment = {key: value for key, value in os.environ.items() if key not in {"PYTHONPATH", "VIRTUAL_ENV"}}
    make = ["make", f"PYTHON={arguments.python}"]
    is_lighter = "$(SERVICE)" in (here / "Makefile").read_text()
    stamp = ".venv/.service" if is_lighter else ".venv/.installed"
    installed = timed([*make, stamp], here, environment)
    size = subprocess.run(["du", "-sm", ".venv"], cwd=here, check=True, capture_output=True, text=True).stdout
    return {
        "installation": installed["all"],
        "megabytes": int(size.split()[0]),
        "run": timed([*make, "run"], here, environment),
    }


def timed(command: list[str], here: Path, environment: dict[str, str]) -> dict[str, dict[str, float]]:
    """Seconds up to the line that ends each stage, and from the command to its end."""
    begun, meter = time.monotonic(), ProcessorMeter()
    process = subprocess.Popen(
        command, cwd=here, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    meter.start()
    stages: dict[str, dict[str, float]] = {}
    lines = []
    for line in process.stdout or ():
        lines.append(line)
        for mark, stage in STAGES:
            if mark in line and stage not in stages:
                stages[stage] = {"until": round(time.monotonic() - begun, 1), "processor": round(meter.seconds(), 1)}
    if process.wait():
        sys.exit(f"{command} failed: {''.join(lines[-20:])}")
    wall = time.monotonic() - begun
    return {**stages, "all": {"wall": round(wall, 1), "processor": round(meter.stop(), 1)}}


class ProcessorMeter(threading.Thread):
    """Processor time of all processes below this one since it was made, those of Ray, which has its own, included."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self._used: dict[tuple[int, float], float] = {}
        self._over = threading.Event()

    def run(self) -> None:
        """Look until it is stopped."""
        while not self._over.wait(0.5):
            self._look()

    def seconds(self) -> float:
        """So far."""
        return sum(self._used.copy().values())

    def stop(self) -> float:
        """The last look."""
        self._over.set()
        self.join()
        return self.seconds()

    def _look(self) -> None:
        for one in psutil.Process().children(recursive=True):
            try:
                times = one.cpu_times()
            except psutil.Error:  # it has ended
                continue
            self._used[one.pid, one.create_time()] = times.user + times.system


if __name__ == "__main__":
    main()
