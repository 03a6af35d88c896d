"""What is sent with a job: what the submitter named, what that imports, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from jobs.experiment.spec_files import load_experiment, shipped_experiments
from jobs.experiment.user_modules import local_modules, named_modules
from jobs.experiment.yaml_source import SpecError
from jobs.remote import package
from jobs.remote.package import write_package
from jobs.remote.packing import write_archive
from jobs.results.storage import Folder


def test_named_modules(small: Path) -> None:
    """Import paths stand for learners, selectors, the environment, the performance measure, and in sweeps."""
    overrides = [
        "environment={id: 'worlds.deep:Corridor'}",
        "learners.Q_red={type: 'walkers:Walker'}",
        "arms.APEL.selector={type: 'pickers:Mine'}",
        "variables={}",
        "sweep={how: {performance: ['other_measures:a', 'measures:speed']}}",
    ]
    assert named_modules(load_experiment(str(small), overrides)) == [
        "measures", "other_measures", "pickers", "walkers", "worlds",
    ]  # fmt: skip
    for name in shipped_experiments():  # which name what is installed, and nothing else
        assert set(named_modules(load_experiment(name))) <= {"stable_baselines3"}


def test_gymnasium_ids_with_a_module(small: Path) -> None:
    """A Gymnasium id may name the module that registers it."""
    assert named_modules(load_experiment(str(small), ["environment.id=my_worlds:Corridor-v0"])) == ["my_worlds"]


def test_what_is_sent(small: Path, tmp_path: Path) -> None:
    """Files and whole packages of the folder that are imported, wherever in the code; installed modules are not."""
    files = {
        "walkers.py": "import numpy\nfrom helpers import a\n",
        "helpers.py": "def f():\n    import late\n    from big.part import x\n",
        "late.py": "",
        "big/__init__.py": "from . import part\n",
        "big/part.py": "x = 1\n",
        "big/table.csv": "1\n",
        "big/__pycache__/part.pyc": "",
        "big/.secret": "",
        "unrelated.py": "",
        "passwords.txt": "",
    }
    for name, content in files.items():
        path = tmp_path / "mine" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    found = local_modules(["walkers", "gymnasium"], tmp_path / "mine")
    assert [path.name for path in found] == ["big", "helpers.py", "late.py", "walkers.py"]
    write_package(load_experiment(str(small)), found, tmp_path / "sent")
    sent = {str(path.relative_to(tmp_path / "sent")) for path in (tmp_path / "sent").rglob("*") if path.is_file()}
    assert sent == {
        "experiment.yaml", "walkers.py", "helpers.py", "late.py", "big/__init__.py", "big/part.py", "big/table.csv",
    }  # fmt: skip
    again = load_experiment(str(tmp_path / "sent" / "experiment.yaml"))
    assert again.identity == load_experiment(str(small)).identity


def test_too_large(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What no dashboard would take is refused before anything is written."""
    monkeypatch.setattr(package, "_MAX_BYTES", 10)
    (tmp_path / "large.py").write_text("x" * 11)
    with pytest.raises(SpecError, match=r"large\.py: found 0 MiB, expected at most"):
        write_package(load_experiment(str(small)), [tmp_path / "large.py"], tmp_path / "sent")
    assert not (tmp_path / "sent").exists()


def test_module_that_is_no_python(tmp_path: Path) -> None:
    """A module that cannot be read is named with its line."""
    (tmp_path / "broken.py").write_text("x = 1\ndef f(:\n")
    with pytest.raises(SpecError, match=r"broken\.py:2: found"):
        local_modules(["broken"], tmp_path)


def test_archive_holds_results_alone(tmp_path: Path) -> None:
    """Checkpoints and claims stay where they are; a folder without results is no archive."""
    import tarfile

    folder = Folder(str(tmp_path / "results"))
    for name in ("runs.parquet", "episodes/arm=A/0.parquet", "checkpoints/arm=A/0.npz", "claims/0.json"):
        folder.write(name, name.encode())
    write_archive(folder, tmp_path / "archive.tar")
    with tarfile.open(tmp_path / "archive.tar") as archive:
        assert archive.getnames() == ["episodes/arm=A/0.parquet", "runs.parquet"]
    with pytest.raises(FileNotFoundError, match="found no results"):
        write_archive(Folder(str(tmp_path / "nothing")), tmp_path / "empty.tar")
