"""Everything with one command: what it runs, what it writes, and that it goes on where it stopped."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment, shipped_experiments, shipped_galleries
from jobs.reproduction import run_all as reproduction
from jobs.reproduction.run_all import reproduced_plans, scaled
from tests.command_line import call, printed

FIGURES = {
    "3.2", "3.3", "3.4", "4.1", "4.4", "4.5", "4.7", "4.8", "4.11", "4.12", "4.13", "4.14", "4.15", "4.18", "4.19",
    "4.20",
}  # fmt: skip


def test_every_figure_has_a_file() -> None:
    """Every figure of the dissertation is reproduced by some file, those with neural networks at full size and at that
    of one machine.
    """
    for group in ("deep", "cluster"):
        experiments = [load_experiment(name) for name in shipped_experiments(group)]
        assert {figure for experiment in experiments for figure in experiment.figures} == {
            "4.6",
            "4.9",
            "4.10",
            "4.16",
            "4.17",
        }
    experiments = [load_experiment(name) for name in shipped_experiments("tabular")]
    found = {figure for experiment in experiments for figure in experiment.figures}
    found |= {figure for gallery in shipped_galleries().values() for figure in gallery.figures}
    assert found == FIGURES


def test_scales() -> None:
    """A scale changes the number of runs, and so no row: a hundred, ten or two; three of thirty are a tenth."""
    main_job, sweep = load_experiment("distractor-maze"), load_experiment("hyperparameters-train-time")
    runs = {scale: (scaled(main_job, scale).runs, scaled(sweep, scale).runs) for scale in ("smoke", "tenth", "full")}
    assert runs == {"smoke": (2, 2), "tenth": (10, 3), "full": (100, 30)}
    assert scaled(main_job, "smoke").identity == main_job.identity


def test_all_experiments_small_ones_first() -> None:
    """Each experiment of a group is run, and an interruption leaves most of them done."""
    plans = reproduced_plans("full", "tabular")
    assert sorted(plan.experiment.name for plan in plans) == sorted(shipped_experiments("tabular"))

    def size(plan: Plan) -> int:
        return sum(one.point.experiment.episodes * len(one.spec.learner_names) for one in plan.arm_points)

    sizes = [plan.experiment.runs * size(plan) for plan in plans]
    assert sizes == sorted(sizes)


def test_command_writes_everything_and_resumes(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ledger, tables, figures and one page that loads nothing from anywhere; the second call plays no run."""
    monkeypatch.setattr(reproduction, "shipped_experiments", lambda _: {"small-maze": ""})
    monkeypatch.setattr(reproduction, "load_experiment", lambda _: load_experiment(str(small)))
    arguments = ("reproduce", "--scale", "smoke", "--placement", "local", "--results", str(tmp_path))
    assert "small-maze: 6 runs in" in printed(capsys, *arguments)
    folder = tmp_path / "reproduction"
    claims = pd.read_parquet(folder / "claims.parquet")
    assert set(claims["verdict"]) == {"missing"}  # none is about this experiment
    assert len(pd.read_csv(folder / "tables" / "small-maze.csv")) == 3
    pictures = {path.relative_to(folder / "figures").as_posix() for path in folder.rglob("*.png")}
    assert {
        "small-maze/train_time.png",
        "theory/growth.png",
        "theory/design.png",
        "example-mazes/mazes.png",
    } <= pictures
    page = (folder / "report.html").read_text()
    assert page.count('src="data:image/svg+xml;base64,') == page.count('src="') == len(pictures)
    assert "Ledger of claims" in page
    for loading in ("<script", "@import", "<link"):
        assert loading not in page
    assert "small-maze: 0 runs in" in printed(capsys, *arguments)


def test_unknown_scale_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """One line, exit 2."""
    code, error = call(capsys, "reproduce", "--scale", "half")
    assert code == 2
    assert "--scale: found 'half', expected smoke, tenth or full" in error
