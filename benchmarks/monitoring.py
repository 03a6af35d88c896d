"""What watching a job costs: the main job with and without observers, in turn. ``python -m benchmarks.monitoring [n]``.

With: metrics for Prometheus, the status file, the lines of a log, TensorBoard's event files. All of it is done by the
driver, whose processor time is compared beside the wall time: other work on the machine disturbs it less.
"""

from __future__ import annotations

import io
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console

from cluster.launch import ray_cluster
from jobs.experiment.spec_files import load_experiment
from jobs.progress.apart import Apart
from jobs.progress.job_observer import JobInfo
from jobs.progress.observers import NO_OBSERVER, Observer, Observers
from jobs.progress.prometheus import PrometheusObserver
from jobs.progress.status_file import StatusFile
from jobs.progress.tensorboard import EventFiles
from jobs.progress.terminal import TerminalObserver
from jobs.results.manifest import versions
from jobs.runner import Settings, run_experiment


def observers(folder: Path) -> Observer:
    """All that a submitted job can have."""
    about = {"experiment": "distractor-maze", "identity": "", "results": ""}
    log = Console(file=io.StringIO(), width=120)
    job = JobInfo("distractor-maze", "", "", "job", load_experiment("distractor-maze").content())
    board = Apart("tensorboard", EventFiles(str(folder / "board")), job, print)
    return Observers(
        [PrometheusObserver("distractor-maze", "job"), StatusFile("job", about), TerminalObserver(log), board]
    )


def measure(*, watched: bool) -> tuple[float, float]:
    """Wall and processor seconds of one main job."""
    with tempfile.TemporaryDirectory() as name:
        observer = observers(Path(name)) if watched else NO_OBSERVER
        began, before = time.monotonic(), time.process_time()
        run_experiment(load_experiment("distractor-maze"), Settings(results=f"{name}/results"), observer)
        return time.monotonic() - began, time.process_time() - before


def main() -> None:
    """Print and store the medians, and their ratios."""
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    found: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
    with ray_cluster(dashboard=False):
        measure(watched=True)  # compiled code, and the pool of Ray's workers
        for number in range(2 * repetitions):
            watched = number % 2 == 0
            found[watched].append(measure(watched=watched))
    medians = {
        watched: [statistics.median(column) for column in zip(*times, strict=True)] for watched, times in found.items()
    }
    for position, what in enumerate(("wall time", "driver's processor time")):
        without, with_ = medians[False][position], medians[True][position]
        print(f"{what:24} without {without:6.2f} s, with {with_:6.2f} s: {100 * (with_ / without - 1):+.1f} %")
    stored = {"versions": versions(), "without": found[False], "with": found[True]}
    Path("benchmarks/results/monitoring.json").write_text(json.dumps(stored, indent=2) + "\n")


if __name__ == "__main__":
    main()
