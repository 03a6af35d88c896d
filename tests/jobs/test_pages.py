"""Tables, figures and the report, from the files alone."""

from __future__ import annotations

import re
import shutil
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jobs.cli import main
from jobs.runner import Settings, run_experiment
from jobs.spec_files import load_experiment
from tests.same_rows import folder_of


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Standard output of a command that succeeds."""
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["apel", *arguments])
        with pytest.raises(SystemExit) as caught:
            main()
    assert caught.value.code in (0, None)
    return capsys.readouterr().out


@pytest.fixture
def results(small: Path, tmp_path: Path) -> Path:
    """A finished experiment, moved to where nothing else is."""
    experiment = load_experiment(str(small), ["title=Train time <in> a maze"])
    outcome = run_experiment(experiment, Settings(results=str(tmp_path / "made"), placement="local"))
    moved = tmp_path / "moved"
    shutil.move(folder_of(outcome), moved)
    return moved


def test_list_names_every_experiment(capsys: pytest.CaptureFixture[str]) -> None:
    """`apel list` names experiments with figures, arms and runs."""
    out = call(capsys, "list")
    assert "distractor-maze" in out
    assert "4.7, 4.8" in out


def test_validate_says_what_is_valid(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`apel validate` tells arms and runs."""
    assert "small-maze" in call(capsys, "validate", str(small))


def test_run_ends_with_table_and_paths(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`apel run` ends with the table and paths that exist; --quiet says nothing; a second time it says so."""
    arguments = ["run", str(small), "--placement", "local", "--results", str(tmp_path / "results")]
    out = call(capsys, *arguments)
    paths = [line.strip() for line in out.splitlines() if line.startswith(str(tmp_path))]
    assert len(paths) == 8
    assert all(Path(path).exists() for path in paths)
    assert out.index("95 % interval") < out.index(paths[0])
    assert call(capsys, *arguments, "--quiet") == ""
    assert "has all its runs" in call(capsys, *arguments)


def test_show_is_complete(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing of the table is cut off where the output is no terminal."""
    out = call(capsys, "show", str(results))
    assert "…" not in out
    for word in ("arm", "runs", "train time", "95 % interval", "IQM", "censored", "wall time", "steps/s", "SSBAS"):
        assert word in out


def test_figures_are_drawn_again(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same results give the same files; pictures are not blank."""
    paths = [Path(line) for line in call(capsys, "figures", str(results)).splitlines()]
    assert {path.suffix for path in paths} == {".png", ".svg", ".html"}
    before = {path: path.read_bytes() for path in paths}
    call(capsys, "figures", str(results))
    assert {path: path.read_bytes() for path in paths} == before
    for path in paths:
        if path.suffix == ".png":
            assert np.asarray(Image.open(path).convert("L")).std() > 10


class _Links(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]


def test_report_is_self_contained(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The page refers to nothing outside itself, holds table and pictures, and escapes what users write."""
    call(capsys, "figures", str(results))
    page = (results / "report.html").read_text()
    parser = _Links()
    parser.feed(page)
    assert all(link.startswith("#") for link in parser.links)
    assert not re.search(r"@import|url\((?!#)", page)
    assert page.count("<svg") == 2
    assert "Train time &lt;in&gt; a maze" in page
    assert "SSBAS" in page


def test_gallery_is_drawn_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`apel figures theory` needs no results, and draws below results/."""
    monkeypatch.chdir(tmp_path)
    paths = call(capsys, "figures", "theory").split()
    assert len(paths) == 6
    assert all(path.startswith("results/theory/") and Path(path).exists() for path in paths)
