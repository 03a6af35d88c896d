"""Commands that read run no code of the folder that they read, or of the one that they stand in, unless told to."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jobs.cli.main import main
from jobs.cli.user_modules import find_user_modules, leave_working_directory
from jobs.experiment.foreign_code import foreign_code
from jobs.experiment.spec_files import load_experiment, shipped_experiments
from tests.command_line import call
from tests.conftest import SMALL

PROJECT = Path(__file__).parents[3]
PLANTED = "from pathlib import Path\nPath(__file__).with_name('gone').touch()\n"
NAMES = ("matplotlib", "PIL", "ray", "typer", "rich", "yaml", "numpy", "pathlib", "requests", "tensorboardX")
CHANGES = [
    ("arms.APEL.selector.type=os:system", "arms.APEL.selector.type: 'os:system'"),
    ("arms.APEL.selector.type=evil:Selector", "arms.APEL.selector.type: 'evil:Selector'"),
    ("learners.Q_full.type=evil:Learner", "learners.Q_full.type: 'evil:Learner'"),
    ("learners.Q_full.type=evil:_hidden", "learners.Q_full.type: 'evil:_hidden'"),
    ("environment.id=evil:Environment", "environment.id: 'evil:Environment'"),
    ("environment.id=evil:Environment-v0", "environment.id: 'evil:Environment-v0'"),
    ("performance=evil:measure", "performance: 'evil:measure'"),
    ("learners.Q_full.algorithm=evil.inner:DQN", "learners.Q_full.algorithm: 'evil.inner:DQN'"),
    ("learners.Q_full.policy_kwargs={net: [{x: 'evil:Net'}]}", "learners.Q_full.policy_kwargs.net.x: 'evil:Net'"),
    ("environment.options={wrapper: 'evil:_W'}", "environment.options.wrapper: 'evil:_W'"),
    ("sweep={performance: [return, 'evil:measure']}", "performance: 'evil:measure'"),
    ("variables={which: [a, 'evil:A']}", "variables.which: 'evil:A'"),
]


def results_of(folder: Path, change: str) -> Path:
    """Results as a stranger might send them: an experiment with a change, and as many rows as are looked at."""
    spec = folder / "small.yaml"
    spec.write_text(SMALL)
    results = folder / "results"
    results.mkdir()
    (results / "spec.yaml").write_text(load_experiment(str(spec), ["criterion=null", change]).to_yaml())
    row = {"arm": ["APEL"], "sweep": [""], "run_index": [0], "episodes": [3], "steps": [9]}
    pq.write_table(pa.table(row), results / "runs.parquet")
    return results


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with a module that tells whether it was run."""
    (tmp_path / "evil.py").write_text(PLANTED)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), "", *sys.path])
    monkeypatch.delitem(sys.modules, "evil", raising=False)
    return tmp_path


@pytest.mark.parametrize(("change", "named"), CHANGES)
def test_foreign_code_is_not_run(change: str, named: str, elsewhere: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`apel watch` of results that name code that is not shipped says which, and runs none of it."""
    code, error = call(capsys, "watch", str(results_of(elsewhere, change)))
    assert code == 2
    assert "spec.yaml: found code that is not shipped" in error
    assert named in error
    assert "--trust" in error
    assert not (elsewhere / "gone").exists()


def test_trusted_code_is_run(elsewhere: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With --trust it is found where the command is run, and run."""
    code, error = call(capsys, "watch", str(results_of(elsewhere, CHANGES[6][0])), "--trust")
    assert (elsewhere / "gone").exists()
    assert (code, "has no 'measure'" in error) == (2, True)


def test_shipped_code_needs_no_trust() -> None:
    """No shipped experiment names anything else; devices are no code."""
    for name in shipped_experiments():
        assert foreign_code(load_experiment(name)) == []
    assert foreign_code(load_experiment("cartpole-learners", ["environment.options={device: 'cuda:1'}"])) == []


@pytest.mark.parametrize("command", ["show", "figures"])
def test_reading_stored_results_runs_nothing(command: str, elsewhere: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither does a table or a figure need what an experiment names."""
    results = results_of(elsewhere, "performance=evil:measure")
    row = {"arm": ["APEL"], "sweep": [""], "runs": [1], "episodes": [3], "steps": [9]}
    pq.write_table(pa.table(row), results / "summary.parquet")
    assert call(capsys, command, str(results))[0] == 0
    assert not (elsewhere / "gone").exists()


def test_planted_modules_are_not_imported(tmp_path: Path) -> None:
    """A real process in a folder with modules named like ours, the standard library's and installed ones."""
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text(PLANTED)
    command = [sys.executable, "-m", "jobs", "jobs", "--address", "http://127.0.0.1:9"]
    variables = os.environ | {"PYTHONPATH": str(PROJECT)}
    done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "could not reach a dashboard" in done.stderr
    assert not (tmp_path / "gone").exists()


def test_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The working directory leaves the path under whatever name it has, and comes back behind everything else."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(tmp_path)
    monkeypatch.setattr(sys, "path", ["", "/installed", str(tmp_path / "link"), ".", str(tmp_path), "/other"])
    leave_working_directory()
    assert sys.path == ["/installed", "/other"]
    find_user_modules()
    find_user_modules()
    assert sys.path == ["/installed", "/other", str(tmp_path)]


def test_path_in_our_own_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where this program lies, or what is installed, the working directory stays."""
    monkeypatch.chdir(PROJECT)
    monkeypatch.setattr(sys, "path", [str(PROJECT)])
    leave_working_directory()
    assert sys.path == [str(PROJECT)]


def test_hostile_labels_are_shown(elsewhere: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A label that looks like markup, or holds commands to the terminal, is shown as it is."""
    results = results_of(elsewhere, "runs=1")
    rows = {
        "arm": ["[/a]", "b"],
        "sweep": ["\x1b]0;x\x07", "[red]"],
        "runs": [1, 1],
        "episodes": [3, 3],
        "steps": [9, 9],
    }
    pq.write_table(pa.table(rows), results / "summary.parquet")
    (results / "manifest.json").write_text('{"experiment": "[/red]\\u001b[2J", "identity": "", "sessions": []}')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["apel", "show", str(results)])
        with pytest.raises(SystemExit) as caught:
            main()
    shown = capsys.readouterr().out
    assert not caught.value.code
    assert "\x1b" not in shown
    for text in ("[/a]", "[red]", "[/red]\\u001b[2J", "\\u001b]0;x\\u0007"):
        assert text in shown
