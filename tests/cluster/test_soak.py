"""A few faults of each kind in one job on three nodes; ``python -m benchmarks.soak`` is the long one."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

from tests.soak.faults import all_injectors, deck
from tests.soak.job import PROJECT

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
