"""A few faults of each kind in one job on three nodes; ``python -m benchmarks.soak`` is the long one."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cluster.events import ShardDone, ShardProgress
from cluster.local import LocalHosts
from tests.cluster.shards import Memory, play, shard_of
from tests.soak.faults import all_injectors, deck
from tests.soak.job import PROJECT
from tests.soak.pace import Pace, PacedCoordinator, PacedExecution

KINDS = ["coordinator killed", "driver killed", "learner killed", "node lost", "storage fault", "storage outage"]


@pytest.mark.soak
@pytest.mark.ray
@pytest.mark.timeout(420)
def test_soak(tmp_path: Path) -> None:
    """Every kind of fault hits a job at random moments, and the rows are those of an undisturbed one.

    In a process of its own: the tests' own Ray must not be there.
    """
    output = tmp_path / "soak.json"
    options = ["--faults", "6", "--seed", "3", "--runs", "4", "--episodes", "100", "--no-baseline"]
    options += ["--round-seconds", "0.03"]
    command = [sys.executable, "-m", "benchmarks.soak", *options, "--output", str(output)]
    # Ray's sockets lie in a folder for temporary files, and their paths may not be long.
    env = {**os.environ, "TMPDIR": "/tmp"}
    run = subprocess.run(command, check=False, cwd=PROJECT, env=env, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    record = json.loads(output.read_text())
    assert record["problems"] == []
    assert sorted({fault["kind"] for fault in record["faults"]}) == KINDS
    assert len(record["faults"]) == 6
    assert record["num_runs"] == 12


@pytest.mark.parametrize("num_faults", [6, 8, 100, 250])
def test_deck(num_faults: int) -> None:
    """So many faults as are wanted, some of each kind."""
    nothing = None
    injectors = all_injectors(nothing, nothing, nothing)  # type: ignore[arg-type]
    cards = deck(injectors, num_faults, random.Random(1))
    assert len(cards) == num_faults
    assert sorted({card.name for card in cards}) == KINDS


def test_kept_episodes(small: Path, tmp_path: Path) -> None:
    """A run keeps an episode for each fault to come, through rounds and checkpoints, and ends with the last one."""
    shard = shard_of(small, "runs=2", "episodes=10", "stop_when_met=false", arm="SSBAS")
    pace = Pace(0.0, "SSBAS", 1, str(tmp_path / "faults"))
    memory, undisturbed = Memory(), Memory()
    execution = PacedExecution(
        streak_episodes=1, checkpoint_seconds=0.0, checkpoint_share=1.0, progress_seconds=0.0, pace=pace
    )
    pace.expect(3)
    events = PacedCoordinator(LocalHosts(), memory, memory, execution).run(shard)

    def reached() -> int:
        progress = [next(events) for _ in range(40)][-1]
        assert isinstance(progress, ShardProgress)
        return progress.episodes

    assert reached() == 10 + 7
    before = memory.num_checkpoints
    assert reached() == 10 + 7
    assert memory.num_checkpoints > before
    pace.expect(1)
    assert reached() == 10 + 9
    pace.expect(0)
    assert isinstance(list(events)[-1], ShardDone)
    play(shard, undisturbed)
    assert memory.sorted_rows() == undisturbed.sorted_rows()


def test_pace(small: Path, tmp_path: Path) -> None:
    """A round takes no less than it must, however fast the machine."""
    shard = shard_of(small, "runs=1", "episodes=10", "stop_when_met=false", arm="APEL")
    pace = Pace(0.02, "SSBAS", 0, str(tmp_path / "faults"))
    memory = Memory()
    coordinator = PacedCoordinator(LocalHosts(), memory, memory, PacedExecution(streak_episodes=1, pace=pace))
    began = time.monotonic()
    *_, done = coordinator.run(shard)
    assert isinstance(done, ShardDone)
    assert done.rounds >= 10
    assert time.monotonic() - began >= 9 * 0.02
