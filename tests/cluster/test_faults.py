"""Processes that are killed with signal 9 at a random moment cost time, and nothing in the results."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest

from cluster.shard import Execution
from jobs.experiment.spec_files import load_experiment
from jobs.runner import Settings, run_experiment
from tests.cluster.shards import with_user_code
from tests.command_line import called
from tests.processes import started
from tests.same_rows import assert_same, folder_of

# Rounds of one episode make the job long enough to be hit, and its checkpoints many.
SLOW = Execution(streak_episodes=1, checkpoint_seconds=0.2, progress_seconds=0.05)
OVERRIDES = ("arms={APEL: {learners: [Q_full, Q_red], selector: {type: apel}}}", "episodes=400", "stop_when_met=false")


def _processes(title: str) -> list[psutil.Process]:
    """Those of this process's own Ray alone: another one may be at work on this machine."""
    found = []
    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):
            if (process.cmdline() or [""])[0].startswith(title):
                found.append(process)
    return found


@contextmanager
def _killer(title: str, moment: random.Random, kills: int) -> Iterator[list[int]]:
    """Kill processes whose title begins so, at random moments, as long as the body runs; yields those that were."""
    killed: list[int] = []
    over = threading.Event()

    def work() -> None:
        while not over.wait(0.05) and len(killed) < kills:
            victims = [process for process in _processes(title) if process.pid not in killed]
            if victims and not over.wait(moment.uniform(0.3, 1.0)):
                victim = moment.choice(victims)
                with suppress(ProcessLookupError):
                    os.kill(victim.pid, signal.SIGKILL)
                    killed.append(victim.pid)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield killed
    finally:
        over.set()
        thread.join()


@pytest.fixture
def undisturbed(small: Path, tmp_path: Path) -> Path:
    """The rows without any fault."""
    experiment = load_experiment(str(small), OVERRIDES)
    return folder_of(run_experiment(experiment, Settings(results=str(tmp_path / "undisturbed"), placement="local")))


@pytest.mark.ray
@pytest.mark.parametrize(
    ("victim", "title"),
    [("a learner", "ray::LearnerHost"), ("the coordinator", "ray::APEL")],
    ids=["learner", "coordinator"],
)
def test_killed_actor(
    ray_session: None, small: Path, undisturbed: Path, tmp_path: Path, victim: str, title: str
) -> None:
    """A killed learner or coordinator is replaced, and its shard goes on from its checkpoint to the same rows."""
    experiment = load_experiment(str(small), OVERRIDES)
    settings = Settings(results=str(tmp_path / "disturbed"), shard_size=6, execution=SLOW)
    with _killer(title, random.Random(victim), kills=2) as killed:
        outcome = run_experiment(experiment, settings)
    assert killed, f"the job was over before {victim} could be killed"
    assert outcome.failures == []
    assert_same(undisturbed, folder_of(outcome))


@pytest.mark.ray
def test_killed_driver(small: Path, undisturbed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """After the driver was killed the same command goes on where it stopped, to the same rows."""
    overrides = [part for override in OVERRIDES for part in ("--set", override)]
    program = (
        "import sys; from cluster.shard import Execution; from jobs.runner import *; "
        "from jobs.experiment.spec_files import *; "
        "run_experiment(load_experiment(sys.argv[1], sys.argv[3:]), Settings(results=sys.argv[2], shard_size=3, "
        "dashboard=False, num_cpus=2, execution=Execution(streak_episodes=1, checkpoint_seconds=0.2)))"
    )
    results = tmp_path / "disturbed"
    command = [sys.executable, "-c", program, str(small), str(results), *OVERRIDES]
    with started(command) as driver:
        deadline = time.monotonic() + 150
        while not list(results.rglob("*.npz")):
            assert time.monotonic() < deadline, "no checkpoint was written"
            assert driver.poll() is None, "the job was over before it could be killed"
            time.sleep(0.02)
        time.sleep(random.Random("the driver").uniform(0.0, 0.3))
        family = psutil.Process(driver.pid).children(recursive=True)
    # Its Ray would end by itself, as it does in the soak, in half a minute.
    for process in family:
        with suppress(psutil.NoSuchProcess):
            process.kill()
    psutil.wait_procs(family, timeout=100)
    assert list(results.rglob("*.npz"))
    assert not list(results.rglob("runs.parquet"))
    command = ["run", str(small), "--results", str(results), "--quiet", "--shard-size", "3", "--placement", "local"]
    command += overrides
    assert called(capsys, *command).code == 0
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
