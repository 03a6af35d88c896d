"""What keeping models costs: time and bytes, with tables and with networks.

``python -m benchmarks.model_cost``. In this process (no Ray); the ways take turns, and the shortest time of each is
taken.
"Taken out" is ``none`` without the code that asks after each round whether a model is due.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from cluster.models import ModelClock
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import load_experiment
from jobs.results.manifest import versions
from jobs.runner import Settings, run_experiment

_ROUNDS = 3
_BARE = ["criterion=null", "plots=[]"]
CASES: dict[str, tuple[str, str, int, list[str]]] = {
    "tables: distractor-maze, APEL, 100 runs": ("distractor-maze", "APEL", 50_000, [*_BARE, "episodes=500"]),
    "networks: cartpole-learners, DQN, 5 runs": ("cartpole-learners", "DQN", 1_000, [*_BARE, "runs=5", "episodes=80"]),
}


@contextmanager
def without_clock() -> Iterator[None]:
    """As if nothing were there that could keep models."""
    with mock.patch.object(ModelClock, "due", return_value=[]):
        yield


def measure(experiment: Experiment, arm: str) -> tuple[float, int, int]:
    """Seconds of a processor for a job of one arm in one shard; number and bytes of the models."""
    with tempfile.TemporaryDirectory() as name:
        settings = Settings(results=name, placement="local", arms=(arm,), shard_size=100)
        began = time.process_time()
        run_experiment(experiment, settings)
        seconds = time.process_time() - began
        files = [path.stat().st_size for path in Path(name).glob("*/*/models/**/*.npz")]
    return seconds, len(files), sum(files)


def main() -> None:
    """Print and store."""
    stored: dict[str, object] = {}
    for case, (name, arm, every, overrides) in CASES.items():
        ways = {
            "taken out": "none",
            "none": "none",
            "final": "final",
            f"every {every:,} steps": f"{{every_steps: {every}}}",
        }
        experiments = {way: load_experiment(name, [*overrides, f"models={rule}"]) for way, rule in ways.items()}
        measure(experiments["none"], arm)
        found: dict[str, list[tuple[float, int, int]]] = {way: [] for way in ways}
        for _ in range(_ROUNDS):
            for way, experiment in experiments.items():
                if way == "taken out":
                    with without_clock():
                        found[way].append(measure(experiment, arm))
                else:
                    found[way].append(measure(experiment, arm))
        rows = {
            way: {"seconds": min(one[0] for one in ones), "models": ones[0][1], "bytes": ones[0][2]}
            for way, ones in found.items()
        }
        print(case)
        for way, row in rows.items():
            print(f"  {way:22} {row['seconds']:6.2f} s {row['models']:6} models {row['bytes'] / 1e6:8.2f} MB")
        stored[case] = rows
    content = {"versions": versions(), "measured": stored}
    path = Path(__file__).parent / "results" / "model_cost.json"
    path.write_text(json.dumps(content, indent=2) + "\n")


if __name__ == "__main__":
    main()
