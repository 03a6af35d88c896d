"""Jobs on a real cluster, through its dashboard and token alone: submitted, watched, stopped, gone on with, fetched."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from jobs.experiment.spec_files import load_experiment
from jobs.progress.prometheus_series import COUNTERS, GAUGES
from jobs.runner import Settings, run_experiment
from tests.experiments import write_slow
from tests.forks import BIN
from tests.processes import started
from tests.ray_head import Head
from tests.same_rows import assert_same, folder_of

USER_CODE = Path(__file__).parents[2] / "user_code.py"

pytestmark = pytest.mark.ray


@pytest.fixture
def head(head: Head) -> Iterator[Head]:
    """The cluster that all tests share. A test that fails must not leave it a job, which would hold its CPUs."""
    yield head
    stop_jobs(head)


def stop_jobs(head: Head) -> None:
    """Stop what is still pending or running, and wait until it is over."""
    asked, deadline = set[str](), time.monotonic() + 600
    while left := unfinished(head):
        assert time.monotonic() < deadline, f"these jobs cannot be stopped: {left}"
        for job in left - asked:
            ask(head, f"jobs/{job}/stop", "POST")
        asked |= left
        time.sleep(0.2)


def unfinished(head: Head) -> set[str]:
    """The submitted jobs that are not over; the dashboard lists other drivers too."""
    jobs = [job for job in ask(head, "jobs/") if job["status"] in ("PENDING", "RUNNING")]
    return {job["submission_id"] for job in jobs if job["submission_id"]}


def ask(head: Head, what: str, method: str = "GET") -> Any:
    """What the cluster's dashboard answers; faster by far than a start of ``apel``."""
    headers = {"Authorization": f"Bearer {head.env['RAY_AUTH_TOKEN']}"}
    request = urllib.request.Request(f"{head.url}/api/{what}", headers=headers, method=method)
    with urllib.request.urlopen(request, timeout=30) as response:
        return json.load(response)


@pytest.fixture
def slow_while(tmp_path: Path) -> Path:
    """While it is there, the experiment ``slow.yaml`` beside it is slow."""
    return write_slow(tmp_path)


@pytest.fixture
def undisturbed(small: Path, tmp_path: Path) -> Path:
    """The rows of the small experiment, computed here."""
    return folder_of(run_experiment(load_experiment(str(small)), Settings(str(tmp_path / "here"), placement="local")))


def status(head: Head, job: str, cwd: Path) -> dict[str, object]:
    """What ``apel status --json`` says."""
    found: dict[str, object] = json.loads(head.apel("status", job, "--json", cwd=cwd).stdout)
    return found


def wait_until_running(head: Head, job: str, cwd: Path) -> dict[str, object]:
    """Wait until some episodes were played."""
    deadline = time.monotonic() + 600
    while time.monotonic() < deadline:
        found = status(head, job, cwd)
        assert found["state"] in ("pending", "running"), found
        progress = found["progress"]
        if isinstance(progress, dict) and any(arm["episodes"] for arm in progress["arms"].values()):
            return progress
        time.sleep(1.0)
    raise AssertionError("no episode was played")


def check_metrics(head: Head, job: str) -> None:
    """Wait until the node exports the series of a running job: all that are named, with the labels that they have."""
    deadline = time.monotonic() + 600
    wanted = {f"ray_{name}" for name in (*COUNTERS, *GAUGES)}
    # What has not happened yet has no series.
    wanted -= {"ray_apel_restarts_total", "ray_apel_checkpoint_seconds_total", "ray_apel_mean_train_time"}
    found: set[str] = set()
    while not wanted <= found and time.monotonic() < deadline:
        time.sleep(0.5)
        with urllib.request.urlopen(head.metrics_url, timeout=10) as response:
            lines = [line for line in response.read().decode().splitlines() if f'apel_job="{job}"' in line]
        found = {line.partition("{")[0] for line in lines}
    assert wanted <= found
    assert any('arm="both"' in line and 'learner="W"' in line and "concentration" in line for line in lines)
    assert all('experiment="slow"' in line for line in lines)


def test_submit_follow_fetch(head: Head, small: Path, tmp_path: Path, undisturbed: Path) -> None:
    """A submitted experiment gives the rows of a local one; all that is asked of it comes through the dashboard."""
    submitted = head.apel("submit", str(small), "--results", str(tmp_path / "there"), "--follow", cwd=tmp_path)
    job, *log = submitted.stdout.splitlines()
    assert any("18 runs in" in line for line in log)
    found = status(head, job, tmp_path)
    assert (found["state"], found["exit_code"]) == ("done", 0)
    progress = found["progress"]
    assert isinstance(progress, dict)
    assert {name: arm["runs_done"] for name, arm in progress["arms"].items()} == {"Q_full": 6, "APEL": 6, "SSBAS": 6}
    assert list(progress["phases"]) == ["joined", "planned", "first_episode", "ended"]
    listed = head.apel("jobs", cwd=tmp_path).stdout
    assert [line.split()[1:4] for line in listed.splitlines() if line.strip().startswith(job)] == [["done", "18", "18"]]
    assert "18 runs in" in head.apel("logs", job, cwd=tmp_path).stdout
    folder = head.apel("fetch", job, "got", cwd=tmp_path).stdout.strip()
    assert_same(undisturbed, tmp_path / folder)
    assert not (tmp_path / folder / "claims").exists()
    assert "APEL" in head.apel("show", folder, cwd=tmp_path).stdout


def test_in_python(head: Head, tmp_path: Path) -> None:
    """``jobs.submit`` returns a handle with the same verbs. The modules that a spec names are sent, with what they
    import from the same folder, and nothing else.
    """
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "worlds.py").write_text(USER_CODE.read_text())
    (tmp_path / "walkers.py").write_text("from helpers import Walker\n")
    (tmp_path / "helpers.py").write_text("from mine.worlds import Walker as Walker\n")
    (tmp_path / "secrets.env").write_text("PASSWORD=1\n")
    (tmp_path / "own.yaml").write_text(
        "name: own\nruns: 2\nepisodes: 30\nenvironment: {id: 'mine.worlds:Corridor'}\n"
        "learners: {W: {type: 'walkers:Walker'}, Q: {type: q_learning}}\n"
        "arms: {both: {learners: [W, Q], selector: {type: apel}}}\n"
    )
    program = (
        "import sys, jobs\n"
        "experiment = jobs.load_experiment('own.yaml')\n"
        "job = jobs.submit(experiment, address=sys.argv[1], results=sys.argv[2], options=['--placement', 'packed'])\n"
        "status = job.wait()\n"
        "print(job.id, status.state, status.progress['arms']['both']['runs_done'], len(job.logs()) > 0)\n"
        "print(job.fetch('got') / 'runs.parquet')\n"
    )
    command = [sys.executable, "-c", program, head.url, str(tmp_path / "there")]
    printed = subprocess.run(command, cwd=tmp_path, env=dict(head.env), check=True, capture_output=True, text=True)
    first, path = printed.stdout.splitlines()
    job, *words = first.split()
    assert words == ["done", "2", "True"]
    assert (tmp_path / path).exists()
    sent = Path(head.env["XDG_STATE_HOME"], "apel", "jobs", job, "package")
    files = {str(path.relative_to(sent)) for path in sent.rglob("*") if path.is_file()}
    assert files == {"experiment.yaml", "helpers.py", "mine/worlds.py", "walkers.py"}


def both_at_once(command: list[str], head: Head, cwd: Path) -> list[str]:
    """What two processes of the same command print, neither of which may fail."""
    pipe = subprocess.PIPE
    with (
        started(command, cwd=cwd, env=head.env, stdout=pipe, stderr=pipe) as one,
        started(command, cwd=cwd, env=head.env, stdout=pipe, stderr=pipe) as other,
    ):
        said = [process.communicate(timeout=600) for process in (one, other)]
    assert [one.returncode, other.returncode] == [0, 0], said
    return [out for out, _ in said]


def submitted_twice(head: Head, command: list[str], cwd: Path) -> str:
    """Of two submissions of the same at once one is the other; with other options it is refused. The job's name."""
    said = both_at_once([str(BIN / "apel"), *command], head, cwd)
    jobs = {out.split()[0] for out in said}
    assert len(jobs) == 1
    assert sum("is already running this" in out for out in said) == 1
    (job,) = jobs
    other = head.apel(*command, "--shard-size", "3", cwd=cwd, check=False)
    assert other.returncode == 2
    assert f"found the job {job} at work on this experiment" in other.stderr
    return job


def test_stop_and_resume(head: Head, slow_while: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A job is submitted once, whoever asks again. Stopped, it has checkpoints of what was under way; resumed it
    completes, to the undisturbed rows.
    """
    words = ["slow.yaml", "--results", str(tmp_path / "there"), "--placement", "packed", "--shard-size", "2"]
    job = submitted_twice(head, ["submit", *words], tmp_path)
    wait_until_running(head, job, tmp_path)
    # Past the cluster's list of jobs, by another driver, the results themselves refuse.
    here = head.apel("run", *words, cwd=tmp_path, check=False)
    assert here.returncode == 2
    assert f"found results that job {job}, process" in here.stderr
    check_metrics(head, job)
    stopped = head.apel("stop", job, cwd=tmp_path).stdout
    assert stopped.startswith(f"{job}: stopped, ")
    found = status(head, job, tmp_path)
    assert found["state"] == "stopped"
    assert isinstance(found["progress"], dict)
    assert found["progress"]["state"] == "stopped"
    assert len(list((tmp_path / "there").rglob("checkpoints/*/*.npz"))) == 2
    assert not list((tmp_path / "there").rglob("claims/*"))
    slow_while.unlink()
    resumed, *log = head.apel("resume", job, "--follow", cwd=tmp_path).stdout.splitlines()
    assert resumed != job
    assert status(head, resumed, tmp_path)["state"] == "done", log
    monkeypatch.syspath_prepend(tmp_path)
    slow = load_experiment(str(tmp_path / "slow.yaml"))
    whole = run_experiment(slow, Settings(str(tmp_path / "here"), placement="local"))
    assert_same(folder_of(whole), next((tmp_path / "there").rglob("runs.parquet")).parent)


def test_failing_job(head: Head, small: Path, tmp_path: Path) -> None:
    """A job whose runs fail ends as failed, with the exit code and the words of ``apel run``."""
    spec = tmp_path / "broken.yaml"
    (tmp_path / "user_code.py").write_text(USER_CODE.read_text())
    spec.write_text(
        "name: broken\nruns: 2\nepisodes: 30\n"
        "environment: {id: 'user_code:Corridor', options: {fault: raise, episode: 10}}\n"
        "learners: {Q: {type: q_learning}}\narms: {One: {learners: [Q]}}\n"
    )
    words = ("submit", "broken.yaml", "--results", str(tmp_path / "there"), "--placement", "packed", "--follow")
    submitted = head.apel(*words, cwd=tmp_path, check=False)
    assert submitted.returncode == 1
    job = submitted.stdout.splitlines()[0]
    found = status(head, job, tmp_path)
    assert (found["state"], found["exit_code"]) == ("failed", 1)
    assert "the motor is stuck" in str(found["message"])
    assert isinstance(found["progress"], dict)
    assert found["progress"]["arms"]["One"]["runs_failed"] == 2


def test_unknown_job(head: Head, tmp_path: Path) -> None:
    """A job that the cluster does not know is said to be none, in one line."""
    called = head.apel("status", "no-such-job", cwd=tmp_path, check=False)
    assert called.returncode == 1
    assert called.stderr.strip() == (
        "error: found no job 'no-such-job' on this cluster, expected one that `apel jobs` shows"
    )


def test_without_the_token(head: Head, tmp_path: Path) -> None:
    """Who has no token, or another one, can do nothing."""
    for token in ("", "0" * 64):
        stranger = replace(head, env={**head.env, "RAY_AUTH_TOKEN": token, "HOME": str(tmp_path)})
        called = stranger.apel("jobs", cwd=tmp_path, check=False)
        assert (called.returncode, called.stdout) == (1, "")
        assert called.stderr.startswith(f"error: the cluster at {head.url} refuses the token, expected its own in")
        assert called.stderr.count("\n") == 1


def test_driver_without_the_token(head: Head, small: Path, tmp_path: Path) -> None:
    """A driver of one's own is refused in as many words, before Ray is asked."""
    env = {**head.env, "RAY_AUTH_TOKEN": "0" * 64}
    command = [str(BIN / "apel"), "run", str(small), "--address", head.address, "--results", str(tmp_path / "there")]
    called = subprocess.run(command, env=env, capture_output=True, text=True, check=False, timeout=600)
    assert called.returncode == 1
    # Without a warning before it: Ray, which would go on asking for twenty seconds, gives one for each time.
    assert called.stderr.startswith(
        f"error: the Ray cluster at '{head.address}' refuses the token, expected its own in"
    )
