"""Results compared value for value, whatever the order of the files' rows."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from jobs.experiment.spec_files import load_experiment
from jobs.runner import Outcome, Settings, run_experiment


def run_rows(folder: Path) -> pd.DataFrame:
    """``runs.parquet`` by key."""
    return pd.read_parquet(folder / "runs.parquet").sort_values(["arm", "sweep", "run_index"]).reset_index(drop=True)


def episode_rows(folder: Path) -> pd.DataFrame:
    """All of ``episodes/`` by key, lists as tuples."""
    rows = pd.read_parquet(folder / "episodes")
    rows["arm"] = rows["arm"].astype(str)
    for column in ("probability", "performance_estimate", "concentration"):
        rows[column] = [tuple(None if value != value else value for value in values) for values in rows[column]]
    return rows.sort_values(["arm", "sweep", "run_index", "episode"]).reset_index(drop=True)


def folder_of(outcome: Outcome) -> Path:
    """Where an outcome is stored."""
    return Path(outcome.store.folder.path())


def play(spec: Path, results: Path, *overrides: str, **settings: object) -> Path:
    """Run an experiment in which nothing fails; where its results are."""
    outcome = run_experiment(
        load_experiment(str(spec), overrides),
        Settings(results=str(results), dashboard=False, **settings),  # type: ignore[arg-type]
    )
    assert outcome.failures == []
    return folder_of(outcome)


def assert_same(one: Path, other: Path, *arms: str) -> None:
    """Runs and episodes are equal, value for value, and there are some; ``other`` may have only some ``arms``."""
    runs, episodes = run_rows(one), episode_rows(one)
    if arms:
        assert {*arms} <= {*runs["arm"]}
        runs = runs[runs["arm"].isin(arms)].reset_index(drop=True)
        episodes = episodes[episodes["arm"].isin(arms)].reset_index(drop=True)
    assert len(runs) > 0
    assert len(episodes) > 0
    pd.testing.assert_frame_equal(runs, run_rows(other), check_exact=True)
    pd.testing.assert_frame_equal(episodes, episode_rows(other), check_exact=True)
