"""What the README shows works, and what the pages beside it show, word for word."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

import apel as apel_package
from tests.command_line import printed
from tests.forks import apel

ROOT = Path(__file__).parent.parent
DOCS = ("in-python", "own-parts", "command-line", "containers", "first-walk")
README, IN_PYTHON, OWN_PARTS, COMMAND_LINE, CONTAINERS, FIRST_WALK = (
    (ROOT / page).read_text() for page in ("README.md", *(f"docs/{name}.md" for name in DOCS))
)


def blocks(page: str, language: str) -> list[str]:
    """The code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", page, flags=re.DOTALL)


def test_first_screens() -> None:
    """The README is short, code included, and its example has six lines."""
    assert len(README.split()) <= 600
    (example,) = blocks(README, "python")
    assert len(example.strip().splitlines()) <= 6


def test_reader_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The lines of the README run with somebody's environment, in a small size, and end with an agent that acts."""
    (tmp_path / "my_project.py").write_text(
        "import gymnasium\n\n\ndef MyEnv():\n    return gymnasium.make('FrozenLake-v1', is_slippery=False)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (example,) = blocks(README, "python")
    for shown, small in {"episodes=500": "episodes=6", "runs=20": "runs=2, placement='local'"}.items():
        assert shown in example
        example = example.replace(shown, small)
    exec(compile(example, "README.md", "exec"), {"__name__": "__main__"})
    (answer,) = re.findall(r"`(apel\.load\(.*?)\.act\(observation\)`", README)
    agent = eval(answer, {"apel": apel_package})
    assert agent.names == ["DQN", "SAC"]
    assert agent.act(0) in range(4)
    assert "If you have to choose now" in capsys.readouterr().out


def test_python_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The ten lines of Python run, and print what they say."""
    example = next(block for block in blocks(IN_PYTHON, "python") if "apel.Ensemble" in block)
    assert len(example.strip().splitlines()) <= 12
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "in-python.md", "exec"), {"__name__": "__main__"})
    assert "of the last 100 episodes went to the reduced learner" in capsys.readouterr().out


def test_chooser(capsys: pytest.CaptureFixture[str]) -> None:
    """The selector by itself finds the best score."""
    example = next(block for block in blocks(IN_PYTHON, "python") if "apel.Chooser" in block)
    exec(compile(example, "in-python.md", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out == "the best is number 1\n"


@pytest.mark.ray
def test_own_learner(tmp_path: Path) -> None:
    """The learner and the experiment of the page run as actors, from the folder where they lie."""
    learner = next(block for block in blocks(OWN_PARTS, "python") if "class ExpectedSarsa" in block)
    (tmp_path / "my_learners.py").write_text(learner)
    (tmp_path / "my.yaml").write_text(next(block for block in blocks(OWN_PARTS, "yaml") if "my_learners" in block))
    apel("run", "my.yaml", "--cpus", "2", cwd=tmp_path, env=os.environ)
    (folder,) = (tmp_path / "results" / "my-first").iterdir()
    rows = pd.read_parquet(folder / "episodes")
    assert set(rows["selected"]) == {0, 1}
    assert rows["return"].max() == 1.0


def test_own_selector(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The selector of the page is a rule of at most 25 lines, and the command beside it runs with it."""
    rule = next(block for block in blocks(OWN_PARTS, "python") if "class GreedyMean" in block)
    assert len(rule.strip().splitlines()) <= 25
    monkeypatch.chdir(tmp_path)
    for name, text in {
        "my_selectors.py": rule,
        "my_learners.py": next(block for block in blocks(OWN_PARTS, "python") if "class ExpectedSarsa" in block),
        "my.yaml": next(block for block in blocks(OWN_PARTS, "yaml") if "my_learners" in block),
    }.items():
        Path(name).write_text(text)
    (command,) = re.findall(r"^apel (run .*GreedyMean.*)$", OWN_PARTS, flags=re.MULTILINE)
    local = [*shlex.split(command), "--placement", "local", "--quiet"]
    subprocess.run([sys.executable, "-m", "jobs", *local], check=True, timeout=600)
    (folder,) = (tmp_path / "results" / "my-first").iterdir()
    rows = pd.read_parquet(folder / "episodes")
    assert set(rows["selected"]) == {0, 1}
    assert {round(max(p), 9) for p in rows["probability"]} == {0.5, 0.9}  # ties, and 1 − ε/2 with ε = 0.2


def test_commands_exist(capsys: pytest.CaptureFixture[str]) -> None:
    """Every `apel` command and option that these pages name exists."""
    help_texts = {}
    pages = README + OWN_PARTS + COMMAND_LINE + CONTAINERS + FIRST_WALK.replace("$ ", "")
    for line in re.findall(r"^(?:\s+-- )?apel [^\n#]*", pages, flags=re.MULTILINE):
        words = line.replace("--", " --").split()
        words = words[words.index("apel") + 1 :]
        name = words[0]
        if name not in help_texts:
            help_texts[name] = printed(capsys, name, "--help")
        for word in words[1:]:
            if word.startswith("--"):
                assert word in help_texts[name], line
    local = {"doctor", "list", "init", "validate", "run", "show", "figures", "watch", "design", "reproduce", "claims"}
    local |= {"compare", "export", "evaluate"}
    assert set(help_texts) == local | {"submit", "jobs", "status", "logs", "stop", "resume", "fetch"}
