"""Whether jobs on a GPU give the same rows: ``python -m benchmarks.gpu_rows DEVICE SECONDS [FOLDER]``.

A part of `benchmarks.gpu`. Six short runs each of Q-learning and DQN under APEL on MinAtar, and of DQN, ACER and SAC on
CartPole, with all six side by side, once more, by threes and one by one: runs and episodes are compared value for
value. The jobs run beside each other, each a process of its own. One line of JSON per arm and way.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from benchmarks.gpu_rates import shipped

WAYS = {"six": 6, "again": 6, "threes": 3, "one": 1}
DQN = {"type": "dqn", "learning_starts": 100, "replay_size": 2_000, "total_steps": 600}


def experiments(device: str) -> dict[str, dict[str, Any]]:
    """By name, as the files say it."""
    there = {"device": device}
    symbols = {"type": "dqn", **shipped("deep/breakout-minatar"), **DQN, "representation": {"channel": "symbols"}}
    q = {"type": "q_learning", "representation": {"channel": "handcrafted", "reward": "paddle_hit"}}
    common = {"runs": 6, "episodes": 10_000, "record": "all"}
    return {
        "minatar": {
            **common,
            "steps": 1_500,
            "environment": {"id": "apel/MinAtarBreakout-v0"},
            "learners": {"Q": q, "DQN": {**symbols, **there}},
            "arms": {
                "DQN": {"learners": ["DQN"]},
                "APEL": {"learners": ["Q", "DQN"], "selector": {"type": "apel", "decay": 0.01}},
            },
        },
        "cartpole": {
            **common,
            "steps": 600,
            "environment": {"id": "apel/CartPole-v0"},
            "learners": {
                "DQN": {**DQN, **there},
                "ACER": {"type": "acer", **there},
                "SAC": {"type": "sac", "learning_starts": 100, **there},
            },
            "arms": {name: {"learners": [name]} for name in ("DQN", "ACER", "SAC")},
        },
    }


def start(spec: Path, folder: Path, shard_size: int) -> subprocess.Popen[bytes]:
    """The job."""
    command = [sys.executable, "-m", "jobs", "run", str(spec), "--placement", "local", "--shard-size", str(shard_size)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with folder.with_suffix(".log").open("wb") as log:
        return subprocess.Popen(
            [*command, "--fresh", "--quiet", "--results", str(folder)],
            env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
        )  # fmt: skip


def rows(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Runs and episodes of a job, in one order."""
    (found,) = folder.glob("**/runs.parquet")
    runs = pd.read_parquet(found).sort_values(["arm", "run_index"])
    episodes = pd.read_parquet(found.parent / "episodes")
    episodes["arm"] = episodes["arm"].astype(str)
    return runs, episodes.sort_values(["arm", "run_index", "episode"])


def text(table: pd.DataFrame, arm: str) -> list[str]:
    """An arm's rows, every number with all of its digits."""
    return [
        repr([value.tolist() if hasattr(value, "tolist") else value for value in row])
        for row in table[table["arm"] == arm].itertuples(index=False)
    ]


def compared(name: str, folders: dict[str, Path], arms: list[str]) -> Iterator[dict[str, Any]]:
    """Each way beside the first."""
    first = rows(folders["six"])
    for way in list(folders)[1:]:
        other = rows(folders[way])
        for arm in arms:
            pairs = [(text(one, arm), text(two, arm)) for one, two in zip(first, other, strict=True)]
            same = [one == two and len(one) > 0 for one, two in pairs]
            counts = {"run_rows": len(pairs[0][0]), "episode_rows": len(pairs[1][0])}
            yield {"part": "rows", "experiment": name, "arm": arm, "way": way, "same": all(same), **counts}


def measured(device: str, seconds: float, folder: Path) -> Iterator[dict[str, Any]]:
    """All jobs, and what came of them."""
    until, jobs = time.perf_counter() + seconds, dict[tuple[str, str], subprocess.Popen[bytes]]()
    texts = experiments(device)
    for name, found in texts.items():
        spec = folder / f"{name}.yaml"
        spec.write_text(yaml.safe_dump({"name": f"gpu-{name}", "title": name, **found}, sort_keys=False))
        for way, size in WAYS.items():
            jobs[name, way] = start(spec, folder / f"{name}-{way}", size)
    for (name, way), job in jobs.items():
        try:
            code: int | None = job.wait(max(until - time.perf_counter(), 0.1))
        except subprocess.TimeoutExpired:
            job.kill()
            code = None
        if code != 0:
            told = (folder / f"{name}-{way}.log").read_text().splitlines()[-12:]
            yield {"part": "rows", "experiment": name, "way": way, "error": code, "log": told}
    for name, found in texts.items():
        done = {way: folder / f"{name}-{way}" for way in WAYS if jobs[name, way].returncode == 0}
        try:
            yield from compared(name, done, list(found["arms"]))
        except Exception as error:  # noqa: BLE001 - the other experiment is still worth comparing
            yield {"part": "rows", "experiment": name, "error": repr(error)}


if __name__ == "__main__":
    place = Path(sys.argv[3]) if len(sys.argv) > 3 else Path(tempfile.mkdtemp())
    place.mkdir(parents=True, exist_ok=True)
    for one in measured(sys.argv[1], float(sys.argv[2]), place):
        print(json.dumps(one), flush=True)
