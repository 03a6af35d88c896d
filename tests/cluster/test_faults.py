"""A driver or a worker that is killed costs time, and nothing in the results; `test_soak` kills actors and nodes."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from jobs.experiment.spec_files import load_experiment
from jobs.runner import Settings, run_experiment
from tests.cluster.shards import with_user_code
from tests.command_line import called
from tests.processes import started
from tests.same_rows import assert_same, folder_of

OVERRIDES = ("arms={APEL: {learners: [Q_full, Q_red], selector: {type: apel}}}", "episodes=400", "stop_when_met=false")


@pytest.fixture
def undisturbed(small: Path, tmp_path: Path) -> Path:
    """The rows without any fault."""
    experiment = load_experiment(str(small), OVERRIDES)
    return folder_of(run_experiment(experiment, Settings(results=str(tmp_path / "undisturbed"), placement="local")))


def test_killed_driver(small: Path, undisturbed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """After the driver was killed the same command goes on where it stopped, to the same rows."""
    overrides = [part for override in OVERRIDES for part in ("--set", override)]
    program = (
        "import sys; from cluster.shard import Execution; from jobs.runner import *; "
        "from jobs.experiment.spec_files import *; "
        "run_experiment(load_experiment(sys.argv[1], sys.argv[3:]), Settings(results=sys.argv[2], shard_size=3, "
        "placement='local', execution=Execution(streak_episodes=1, checkpoint_seconds=0.2)))"
    )
    results = tmp_path / "disturbed"
    with started([sys.executable, "-c", program, str(small), str(results), *OVERRIDES]) as driver:
        deadline = time.monotonic() + 150
        while not list(results.rglob("*.npz")):
            assert time.monotonic() < deadline, "no checkpoint was written"
            assert driver.poll() is None, "the job was over before it could be killed"
            time.sleep(0.02)
        time.sleep(random.Random("the driver").uniform(0.0, 0.3))
    assert list(results.rglob("*.npz"))
    assert not list(results.rglob("runs.parquet"))
    command = ["run", str(small), "--results", str(results), "--quiet", "--shard-size", "3", "--placement", "local"]
    assert called(capsys, *command, *overrides).code == 0
    folder = next(results.rglob("runs.parquet")).parent
    assert not list(results.rglob("*.npz"))
    assert_same(undisturbed, folder)


@pytest.mark.ray
def test_out_of_memory(small: Path, tmp_path: Path) -> None:
    """A worker that Ray ends since memory runs out costs time alone: its shard goes on to the same rows."""
    overrides = (*with_user_code("", "tests.user_code:Walker"), "environment.options.fault=''", "episodes=60")
    experiment = load_experiment(str(small), overrides)
    undisturbed = folder_of(
        run_experiment(experiment, Settings(results=str(tmp_path / "undisturbed"), placement="local"))
    )
    marker = tmp_path / "eaten"
    hungry = f"learners.W={{type: 'tests.user_code:Hungry', marker: '{marker}'}}"
    memory = psutil.virtual_memory()
    env = {
        **os.environ,
        # Five gibibytes from here, more than other tests need meanwhile, Ray ends whatever grows.
        "RAY_memory_usage_threshold": f"{(memory.total - memory.available + 5 * 2**30) / memory.total:.4f}",
        "RAY_memory_monitor_refresh_ms": "100",
    }
    command = [sys.executable, "-m", "jobs", "run", str(small), "--results", str(tmp_path / "disturbed"), "--cpus", "2"]
    words = [word for override in (*overrides, hungry) for word in ("--set", override)]
    job = subprocess.run([*command, *words], env=env, capture_output=True, text=True, check=False, timeout=600)
    assert job.returncode == 0, job.stdout + job.stderr
    assert marker.exists()
    assert "its processes died; restarting from its checkpoint in" in job.stdout
    disturbed = next((tmp_path / "disturbed").rglob("runs.parquet")).parent
    assert_same(undisturbed, disturbed)
