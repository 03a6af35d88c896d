"""Tables, figures and the report, from the files alone."""

from __future__ import annotations

import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jobs.analysis.pages.parts import pictures
from jobs.experiment.spec_files import load_experiment
from jobs.results.store import ResultStore
from jobs.runner import Settings, run_experiment
from tests.command_line import printed
from tests.same_rows import folder_of


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
    out = printed(capsys, "list")
    assert "distractor-maze" in out
    assert "4.7, 4.8" in out


def test_validate_says_what_is_valid(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`apel validate` tells arms and runs."""
    assert "small-maze" in printed(capsys, "validate", str(small))


def test_run_ends_with_table_and_paths(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`apel run` ends with the table and paths that exist; --quiet says nothing; a second time it says so."""
    arguments = ["run", str(small), "--placement", "local", "--results", str(tmp_path / "results")]
    out = printed(capsys, *arguments)
    paths = [line.strip() for line in out.splitlines() if line.startswith(str(tmp_path))]
    assert len(paths) == 8
    assert all(Path(path).exists() for path in paths)
    assert out.index("95 % interval") < out.index(paths[0])
    assert printed(capsys, *arguments, "--quiet") == ""
    assert "has all its runs" in printed(capsys, *arguments)


def test_show_is_complete(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing of the table is cut off where the output is no terminal."""
    out = printed(capsys, "show", str(results))
    assert "…" not in out
    for word in ("arm", "runs", "train time", "95 % interval", "IQM", "censored", "wall time", "steps/s", "SSBAS"):
        assert word in out


def test_a_piped_table_is_as_wide_as_it_needs(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names of any length are whole; without a criterion the table tells the return, and of one run no spread."""
    arm, label = f"Q{'_long' * 15}", "x" * 90
    overrides = [
        f"arms={{{arm}: {{learners: [Q_full]}}}}",
        "criterion=null",
        f"sweep={{cap: {{episodes: [5], label: [{label}]}}}}",
        "plots=[]",
    ]
    options = ["--placement", "local", "--results", str(tmp_path / "results"), "--runs", "1"]
    out = printed(capsys, "run", str(small), *options, *(word for one in overrides for word in ("--set", one)))
    heads, row = (next(line for line in out.splitlines() if word in line) for word in ("return, last tenth", label))
    assert arm in row
    assert "…" not in heads + row
    assert heads.split() == ["arm", "sweep", "runs", "return,", "last", "tenth", "median", "steps"]
    assert len(row.split()) == 6  # so few steps have no unit


def test_figures_are_drawn_again(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same results give the same files; pictures are not blank."""
    paths = [Path(line) for line in printed(capsys, "figures", str(results)).splitlines()]
    assert {path.suffix for path in paths} == {".png", ".svg", ".html"}
    before = {path: path.read_bytes() for path in paths}
    printed(capsys, "figures", str(results))
    assert {path: path.read_bytes() for path in paths} == before
    for path in paths:
        if path.suffix == ".png":
            assert np.asarray(Image.open(path).convert("L")).std() > 10


class _Links(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]


def test_report_is_self_contained(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The page refers to nothing outside itself, holds table and pictures, and escapes what users write."""
    printed(capsys, "figures", str(results))
    page = (results / "report.html").read_text()
    parser = _Links()
    parser.feed(page)
    assert all(link.startswith("data:image/svg+xml;base64,") for link in parser.links)
    assert not re.search(r"@import|url\((?!#)", page)
    assert len(parser.links) == 2
    assert "Train time &lt;in&gt; a maze" in page
    assert "SSBAS" in page


def test_planted_pictures_are_pictures(small: Path, tmp_path: Path) -> None:
    """Whatever lies among the figures, the page shows it as a picture, or as text: never as a part of itself."""
    (tmp_path / "figures").mkdir()
    planted = "<svg xmlns='http://www.w3.org/2000/svg' onload='alert(1)'><script>alert(2)</script></svg>"
    (tmp_path / "figures" / "a.svg").write_text(planted)
    (tmp_path / "figures" / "b.svg").write_bytes(b"\xff no picture")
    (tmp_path / "figures" / "b_switch.csv").write_text("<script>\n<script>\n")
    curves = "kind: curves, panels: [return], clock: steps, switch: {early: Q_full, late: SSBAS}"
    overrides = ["arms.SSBAS={learners: [Q_red]}", f"plots=[{{name: a, {curves}}}, {{name: b, {curves}}}]"]
    page = "".join(pictures(ResultStore.at(str(tmp_path)), load_experiment(str(small), overrides)))
    parser = _Links()
    parser.feed(page)
    assert parser.tags == ["figure", "img", "figure", "img", "p"]
    assert "alert" not in page


def test_only_figures_of_now(small: Path, tmp_path: Path) -> None:
    """What other plots left behind is not shown, nor the switches of one that no longer marks any."""
    (tmp_path / "figures").mkdir()
    for name in ("train_time.svg", "other.svg", "other_switch.csv"):
        (tmp_path / "figures" / name).write_text(f"<svg>{name}</svg>")
    store = ResultStore.at(str(tmp_path))
    for overrides, expected in (([], "train_time"), (["plots=[{kind: bars, name: other}]"], "other")):
        (shown,) = pictures(store, load_experiment(str(small), overrides))
        assert f'alt="small-maze/{expected}.svg"' in shown


def test_gallery_is_drawn_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`apel figures theory` needs no results, and draws below results/."""
    monkeypatch.chdir(tmp_path)
    paths = printed(capsys, "figures", "theory").split()
    assert len(paths) == 6
    assert all(path.startswith("results/theory/") and Path(path).exists() for path in paths)
