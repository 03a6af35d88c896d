"""What checkpoints cost: the ensemble of the main job with checkpoints at different pace.

``python -m benchmarks.checkpoint_cost``. In this process (no Ray), so that nothing but checkpoints differs.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path

from cluster.events import ShardEvent, ShardProgress
from cluster.shard import Execution, Shard
from jobs.experiment.spec_files import load_experiment
from jobs.progress.observers import Observer
from jobs.progress.progress import JobProgress
from jobs.results.manifest import versions
from jobs.runner import Settings, run_experiment

PACES = {
    "none": Execution(checkpoint_seconds=1e9),
    "every 30 s (default)": Execution(),
    "every 5 s": Execution(checkpoint_seconds=5.0),
    "every second": Execution(checkpoint_seconds=1.0),
    "as often as 5 % allow": Execution(checkpoint_seconds=0.0),
    "every 10 000 episodes": Execution(checkpoint_seconds=1e9, checkpoint_episodes=10_000),
}


class Largest(Observer):
    """Remembers what was spent in checkpoints, and their size."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.seconds = 0.0
        self.num_bytes = 0

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        """Take in a report."""
        if isinstance(event, ShardProgress):
            self.seconds = event.checkpoint_seconds
            files = list(self._folder.rglob("*.npz"))
            self.num_bytes = max([self.num_bytes, *(file.stat().st_size for file in files if file.exists())])


def measure(execution: Execution) -> dict[str, float]:
    """Seconds of a job of one arm in one shard, the part that checkpoints took, and the size of the largest."""
    with tempfile.TemporaryDirectory() as name:
        largest = Largest(Path(name))
        settings = Settings(results=name, placement="local", arms=("APEL",), shard_size=100, execution=execution)
        began = time.monotonic()
        outcome = run_experiment(load_experiment("distractor-maze"), settings, largest)
        wall = time.monotonic() - began
    return {
        "seconds": outcome.seconds,
        "wall_seconds": wall,
        "checkpoint_seconds": largest.seconds,
        "bytes": largest.num_bytes,
    }


def main() -> None:
    """Print and store."""
    measure(PACES["none"])
    found = {name: measure(execution) for name, execution in PACES.items()}
    for name, one in found.items():
        share = one["checkpoint_seconds"] / one["seconds"]
        print(f"{name:24} {one['seconds']:6.2f} s, of which {share:6.2%} checkpoints of {one['bytes'] / 1e6:.1f} MB")
    stored = {"versions": versions(), "measured": found}
    Path("benchmarks/results/checkpoint_cost.json").write_text(json.dumps(stored, indent=2) + "\n")


if __name__ == "__main__":
    main()
