"""The command ``apel`` with rounds of one episode, at a pace that makes any job long enough to be hit, and an account
of what happens: ``python -m tests.soak.command EVENTS PACE run SPEC …``.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TextIO

import cluster.launch
import jobs.cli.main
import jobs.cli.run_commands
from cluster.events import ShardDone, ShardEvent, ShardProgress, ShardRestarted
from cluster.shard import Shard
from jobs.experiment.spec import Experiment
from jobs.progress.observers import Ending, Observer, Observers
from jobs.progress.progress import JobProgress
from jobs.runner import Outcome, Settings, Stopping, run_experiment
from tests.soak.pace import Pace, PacedCoordinator, PacedExecution


class EventLog(Observer):
    """Writes a line of JSON per event, with the time on the clock that all processes of this machine share."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def waiting(self, message: str) -> None:
        """See `Observer`."""
        self._write("waiting", message=message)

    def planned(self, progress: JobProgress) -> None:
        """See `Observer`."""
        self._write("planned")

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        """See `Observer`."""
        about: dict[str, Any] = {"shard": shard.label}
        if isinstance(event, ShardProgress):
            about["episodes"] = event.episodes
        elif isinstance(event, ShardDone):
            about["episodes"] = len(shard.runs) * shard.arm.num_episodes
        elif isinstance(event, ShardRestarted):
            about["error"] = event.error
        self._write(type(event).__name__, **about)

    def ended(self, ending: Ending) -> None:
        """See `Observer`."""
        self._write("ended", ending=ending)

    def _write(self, what: str, **about: Any) -> None:
        self._file.write(json.dumps({"time": time.monotonic(), "what": what, **about}) + "\n")
        self._file.flush()


def main() -> None:
    """Run a command of ``apel``."""
    events, pace = Path(sys.argv.pop(1)), Pace.of_word(sys.argv.pop(1))
    with events.open("w") as file:

        def run(experiment: Experiment, settings: Settings, observer: Observer, stopping: Stopping) -> Outcome:
            often = {"streak_episodes": 1, "checkpoint_share": 0.2, "progress_seconds": 0.1}
            execution = PacedExecution(**{**asdict(settings.execution), **often}, pace=pace)
            observers = Observers([observer, EventLog(file)])
            return run_experiment(experiment, replace(settings, execution=execution), observers, stopping)

        jobs.cli.run_commands.run_experiment = run
        cluster.launch.Coordinator = PacedCoordinator  # type: ignore[attr-defined]
        jobs.cli.main.main()


if __name__ == "__main__":
    main()
