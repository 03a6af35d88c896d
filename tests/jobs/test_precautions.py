"""What is refused, or told, before a job begins."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from jobs import precautions
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.yaml_source import SpecError
from jobs.precautions import of_many_processes, refuse_missing_gpus, refuse_shadowing
from tests.command_line import call


@pytest.fixture(autouse=True)
def _same_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands put their folder on the path."""
    monkeypatch.setattr(sys, "path", list(sys.path))


@pytest.mark.parametrize(
    "name", ["jobs.py", "cluster.py", "apel.py", "apel/__init__.py", "ray.py", "scipy/__init__.py"]
)
@pytest.mark.parametrize("command", ["run", "validate", "submit"])
def test_names_that_collide(
    small: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, name: str, command: str
) -> None:
    """A module of the user's that would hide ours in some process is named at once."""
    monkeypatch.chdir(small.parent)
    path = small.parent / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("def kmeans(points, k):\n    return points[:k]\n")
    code, error = call(capsys, command, str(small))
    assert code == 2
    assert f"error: {path}: found a module of yours with the name of a package" in error
    assert len(error.splitlines()) == 1


def test_names_that_do_not_collide(tmp_path: Path) -> None:
    """Folders that are no packages hide nothing, and a checkout of this program is this program."""
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / "one.yaml").write_text("")
    (tmp_path / "clusters.py").write_text("")
    (tmp_path / "jobs.txt").write_text("")
    refuse_shadowing([tmp_path, Path(precautions.__file__).parent.parent])
    shutil.copy(tmp_path / "clusters.py", tmp_path / "cluster.py")
    with pytest.raises(SpecError, match=r"cluster\.py: found"):
        refuse_shadowing([tmp_path])


def test_clone_beside_a_copy(tmp_path: Path) -> None:
    """Who has installed a copy, and runs commands in the clone that it came from, is told of the remedy."""
    for name in ("apel", "cluster", "jobs"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    with pytest.raises(SpecError, match=rf"found a clone of this program.*: pip install -e {tmp_path}, or run"):
        refuse_shadowing([tmp_path])


def test_all_that_collide_are_named(
    small: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """In one message, also where they lie beside the experiment file, and the command is run elsewhere."""
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    for name in ("cluster.py", "jobs.py"):
        (small.parent / name).write_text("")
    code, error = call(capsys, "run", str(small), "--placement", "local")
    assert code == 2
    assert f"{small.parent}/cluster.py" in error
    assert f"{small.parent}/jobs.py" in error
    assert len(error.splitlines()) == 1


def test_package_that_is_hidden_from_a_script(tmp_path: Path) -> None:
    """A script beside which another `cluster` lies is told so where it imports this program."""
    (tmp_path / "cluster.py").write_text("")
    (tmp_path / "script.py").write_text("import jobs\n")
    env = {**os.environ, "PYTHONPATH": str(Path(precautions.__file__).parent.parent)}
    ended = subprocess.run(
        [sys.executable, tmp_path / "script.py"], env=env, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1
    assert (
        f"ImportError: {tmp_path}/cluster.py: found a module of yours called like the package 'cluster'" in ended.stderr
    )


@pytest.mark.parametrize(
    ("override", "counts_shares", "told"),
    [
        ("learners.Q_full={type: dqn, device: cuda}", False, r"learners\.Q_full\.device: found cuda, but this"),
        ("learners.Q_full={type: dqn, device: 'cuda:1'}", False, "machine has 1 GPU"),
        ("learners.Q_full={type: q_learning, num_gpus: 2}", True, r"num_gpus: found 2\.0, but"),
        ("learners.Q_full={type: q_learning, num_gpus: 2}", False, ""),
        ("learners.Q_full={type: dqn}", True, ""),
    ],
)
def test_gpus_that_are_not_there(
    small: Path, monkeypatch: pytest.MonkeyPatch, override: str, counts_shares: bool, told: str
) -> None:
    """GPUs are asked for where there are too few: one message that names the field, before anything starts."""
    monkeypatch.setattr(precautions, "_num_gpus", lambda: int("1 GPU" in told))
    plan = Plan.of(load_experiment(str(small), [override]))
    if not told:
        refuse_missing_gpus(plan, counts_shares=counts_shares)
        return
    with pytest.raises(SpecError, match=told):
        refuse_missing_gpus(plan, counts_shares=counts_shares)


def test_gpus_are_refused_by_the_command(
    small: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With exit code 2, and nothing written."""
    monkeypatch.chdir(small.parent)
    monkeypatch.setattr(precautions, "_num_gpus", lambda: 0)
    monkeypatch.setattr("ray.is_initialized", lambda: False)  # as in a program of its own
    code, error = call(capsys, "run", str(small), "--placement", "packed", "--set", "learners.Q_full.num_gpus=1")
    assert code == 2
    assert "learners.Q_full.num_gpus: found 1.0, but this machine has no GPU" in error
    assert not (small.parent / "results").exists()


def test_many_learners_are_many_processes(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A word where an arm would take more processes, or memory, than a machine has room for."""
    monkeypatch.setattr(precautions, "_available_bytes", lambda: 8e9)
    plan = Plan.of(load_experiment(str(small)))
    assert of_many_processes(plan, num_cpus=2) == []
    many = Plan.of(load_experiment(str(small), ["arms.APEL.learners={Q_full: 20, Q_red: 20}"]))
    (message,) = of_many_processes(many, num_cpus=1)
    assert "40 learners of an arm are 41 processes for each CPU, 41 in all" in message
    monkeypatch.setattr(precautions, "_available_bytes", lambda: 1e9)
    assert len(of_many_processes(plan, num_cpus=8)) == 1
