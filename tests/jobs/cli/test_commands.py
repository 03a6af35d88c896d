"""What all commands have in common: where they are, how they are found, and what they print for programs."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest
import typer

from jobs.cli.commands import COMMANDS, HIDDEN, loaded
from jobs.remote.status import Status
from tests.command_line import called, printed
from tests.same_rows import play

HEAVY = {"gymnasium", "matplotlib", "numba", "numpy", "pandas", "pyarrow", "ray", "scipy"}
PLACES = [(name, module) for module, names in COMMANDS.items() for name in names]


@pytest.mark.parametrize(("name", "module"), PLACES)
def test_summary(name: str, module: str) -> None:
    """What the program's help says of a command is what the command's own help begins with."""
    first = loaded(name, module).help.partition("\n\n")[0]
    assert " ".join(first.split()) == COMMANDS[module][name]


def test_every_command_is_listed() -> None:
    """No module has a command that cannot be called."""
    names = [*(name for name, _ in PLACES), *HIDDEN]
    assert len(set(names)) == len(names)
    for module in {*COMMANDS, *HIDDEN.values()}:
        listed = {*COMMANDS[module], *(name for name, place in HIDDEN.items() if place == module)}
        assert set(commands_of(module)) == listed


def commands_of(module: str) -> Iterator[str]:
    """The names of a module's commands."""
    app = typer.Typer()
    import_module(f"jobs.cli.{module}").add_to(app)
    for command in app.registered_commands:
        assert command.callback is not None
        yield command.name or command.callback.__name__.replace("_", "-")


def test_help_imports_little() -> None:
    """To be told what there is, nobody waits for what computes; in an interpreter that has imported nothing yet."""
    code = f"""
import sys
from jobs.cli.main import main
sys.argv = ["apel", "--help"]
try:
    main()
except SystemExit:
    print({HEAVY!r} & set(sys.modules))
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert "Usage: apel" in ended.stdout
    assert ended.stdout.endswith("set()\n")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    """That of the installed distribution."""
    assert printed(capsys, "--version") == f"apel {version('apel')}\n"


def test_completion(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """A shell completes commands, and the options of each."""
    monkeypatch.setenv("_APEL_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "apel re")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert called(capsys).out.split() == ["reproduce", "resume"]
    monkeypatch.setenv("COMP_WORDS", "apel compare --js")
    monkeypatch.setenv("COMP_CWORD", "2")
    assert called(capsys).out.split() == ["--json"]


def test_unknown_command(capsys: pytest.CaptureFixture[str]) -> None:
    """A name that is nearly right is put right."""
    ended = called(capsys, "reproduc")
    assert ended.code == 2
    assert "Did you mean 'reproduce'" in ended.err


def test_list_for_programs(capsys: pytest.CaptureFixture[str]) -> None:
    """Experiments and galleries."""
    found = json.loads(printed(capsys, "list", "--json"))
    (main,) = [one for one in found["experiments"] if one["name"] == "distractor-maze"]
    assert main["arms"] == ["Q_full", "Q_red", "APEL", "SSBAS"]
    assert (main["runs"], main["most_episodes"]) == (100, 4 * 100 * 5000)
    assert "theory" in {one["name"] for one in found["galleries"]}


def test_design_for_programs(capsys: pytest.CaptureFixture[str]) -> None:
    """The rows of the table, as numbers; what was not asked for is null."""
    rows = json.loads(printed(capsys, "design", "--explore", "0.05", "--json"))
    assert len(rows) == 4
    assert rows[0]["decay"] == pytest.approx(0.05)
    assert rows[0]["performance"] is None


def test_results_for_programs(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The table of results, and the claims that are held against them."""
    folder = play(small, tmp_path, placement="local")
    rows = json.loads(printed(capsys, "show", str(folder), "--json"))
    assert {"arm", "runs"} <= rows[0].keys()
    claims = json.loads(printed(capsys, "claims", str(tmp_path), "--json"))
    assert {one["verdict"] for one in claims} == {"missing"}


def test_jobs_for_programs(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """What the cluster says of its jobs; a number that is none is null."""
    status = Status("a-1", "running", "", None, {"mean_return": float("nan")})
    monkeypatch.setattr("jobs.remote.status.list_jobs", lambda _: [status])
    (found,) = json.loads(printed(capsys, "jobs", "--json"))
    assert (found["job"], found["progress"]) == ("a-1", {"mean_return": None})
