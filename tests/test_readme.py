"""What the README shows works, word for word."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from jobs.cli import main

README = (Path(__file__).parent.parent / "README.md").read_text()


def blocks(language: str) -> list[str]:
    """The code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_python_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The ten lines of Python run, and print what they say."""
    example = next(block for block in blocks("python") if "apel.Ensemble" in block)
    assert len(example.strip().splitlines()) <= 12
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {"__name__": "__main__"})
    assert "of the last 100 episodes went to the reduced learner" in capsys.readouterr().out


@pytest.mark.ray
def test_own_learner(tmp_path: Path) -> None:
    """The learner and the experiment of the README run as actors, from the folder where they lie."""
    learner = next(block for block in blocks("python") if "class ExpectedSarsa" in block)
    (tmp_path / "my_learners.py").write_text(learner)
    (tmp_path / "my.yaml").write_text(next(block for block in blocks("yaml") if "my_learners" in block))
    command = [sys.executable, "-m", "jobs", "run", "my.yaml", "--cpus", "2", "--quiet"]
    subprocess.run(command, check=True, cwd=tmp_path, timeout=120)
    (folder,) = (tmp_path / "results" / "my-first").iterdir()
    rows = pd.read_parquet(folder / "episodes")
    assert set(rows["selected"]) == {0, 1}
    assert rows["return"].max() == 1.0


def test_commands_exist(capsys: pytest.CaptureFixture[str]) -> None:
    """Every `apel` command and option that the README names exists."""
    help_texts = {}
    for line in re.findall(r"^(?:\s+-- )?apel [^\n#]*", README, flags=re.MULTILINE):
        words = line.replace("--", " --").split()
        words = words[words.index("apel") + 1 :]
        name = words[0]
        if name not in help_texts:
            help_texts[name] = _help(name, capsys)
        for word in words[1:]:
            if word.startswith("--"):
                assert word in help_texts[name], line
    local = {"list", "validate", "run", "show", "figures", "watch", "design", "reproduce", "claims"}
    assert set(help_texts) == local | {"submit", "jobs", "status", "logs", "stop", "resume", "fetch"}


def _help(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What ``apel <command> --help`` prints; in this process, since an interpreter of its own takes two seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["apel", command, "--help"])
        with pytest.raises(SystemExit) as caught:
            main()
    assert caught.value.code in (0, None)
    return capsys.readouterr().out
