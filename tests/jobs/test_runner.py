"""Running, resuming, extending and interrupting an experiment, through the command line and its functions."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import duckdb
import pandas as pd
import polars as pl
import pytest

from cluster.shard import Execution
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.yaml_source import SpecError
from jobs.results.store import ResultStore
from jobs.runner import Outcome, Settings, run_experiment
from tests.command_line import call
from tests.experiments import write_slow
from tests.processes import started
from tests.same_rows import assert_same, folder_of


def run(small: Path, results: Path, *overrides: str, **settings: object) -> Outcome:
    """Run in this process."""
    experiment = load_experiment(str(small), overrides)
    return run_experiment(experiment, Settings(results=str(results), placement="local", **settings))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"placement": "lcal"}, "placement: found 'lcal', expected actors, packed or local; did you mean local?"),
        ({"shard_size": 0}, "shard_size: found 0, expected a whole number, at least 1"),
        ({"num_cpus": 1.5}, "num_cpus: found 1.5, expected a whole number, at least 1"),
    ],
)
def test_bad_settings(settings: dict[str, object], expected: str) -> None:
    """What a script gives is looked at as the command line's options are."""
    with pytest.raises(SpecError) as caught:
        Settings(**settings)  # type: ignore[arg-type]
    assert str(caught.value) == expected


def test_second_time_computes_nothing(small: Path, tmp_path: Path) -> None:
    """A complete experiment is not computed again; its files stay as they are."""
    first = run(small, tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.parquet")}
    second = run(small, tmp_path)
    assert (first.num_computed, second.num_computed) == (18, 0)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.parquet")} == before


def test_more_runs_compute_only_the_new(small: Path, tmp_path: Path) -> None:
    """With more runs the old ones are kept, and the whole equals what it is in one go."""
    run(small, tmp_path / "grown", "runs=3")
    grown = run(small, tmp_path / "grown", "runs=6")
    assert grown.num_computed == 9
    assert_same(folder_of(grown), folder_of(run(small, tmp_path / "whole", "runs=6")))


def test_arms_one_by_one(small: Path, tmp_path: Path) -> None:
    """Arms that are computed one by one give the rows of all at once."""
    for arm in ("SSBAS", "Q_full", "APEL"):
        outcome = run(small, tmp_path / "single", arms=(arm,))
    assert outcome.num_computed == 6
    assert_same(folder_of(outcome), folder_of(run(small, tmp_path / "whole")))


def test_fresh_starts_over(small: Path, tmp_path: Path) -> None:
    """--fresh forgets what was computed."""
    run(small, tmp_path)
    assert run(small, tmp_path, fresh=True).num_computed == 18


def test_another_spec_has_another_folder(small: Path, tmp_path: Path) -> None:
    """Whatever changes a row changes the identity; the number of runs does not."""
    base = load_experiment(str(small)).identity
    assert load_experiment(str(small), ["runs=7"]).identity == base
    assert load_experiment(str(small), ["title=other"]).identity == base
    for override in (
        "seed=1",
        "episodes=81",
        "arms.APEL.selector.decay=0.02",
        "record=log",
        "learners.Q_full.discount=0.9",
    ):
        assert load_experiment(str(small), [override]).identity != base


def test_half_written_shard_is_not_counted(small: Path, tmp_path: Path) -> None:
    """Episode rows of a shard that was never committed are thrown away, also when shards are cut anew."""
    outcome = run(small, tmp_path / "torn", shard_size=3)
    folder = folder_of(outcome)
    (folder / "parts" / "arm=APEL" / "000000-000002.parquet").unlink()
    assert run(small, tmp_path / "torn", shard_size=2).num_computed == 3
    assert_same(folder, folder_of(run(small, tmp_path / "whole")))


def test_files_open_everywhere(small: Path, tmp_path: Path) -> None:
    """pandas, polars and DuckDB read runs and episodes as they are, and agree."""
    folder = folder_of(run(small, tmp_path))
    frame = pd.read_parquet(folder / "runs.parquet")
    assert list(frame.columns[:11]) == [
        "experiment", "arm", "sweep", "run_index", "seed", "train_time", "censored",
        "adaptation_time", "steady_state", "episodes", "steps",
    ]  # fmt: skip
    assert {"optimal_length", "dropped"} <= set(frame.columns)
    assert frame["dropped"].isin(["x", "y", "distractor"]).all()
    expected = int(frame["episodes"].sum())
    assert len(pd.read_parquet(folder / "episodes")) == expected
    assert pl.read_parquet(folder / "episodes" / "**" / "*.parquet", hive_partitioning=True).height == expected
    query = f"select arm, count(*), avg(return) from '{folder}/episodes/*/*.parquet' group by arm"
    assert sum(row[1] for row in duckdb.sql(query).fetchall()) == expected
    lists = pl.read_parquet(folder / "episodes" / "arm=APEL" / "*.parquet")
    assert lists["probability"].list.sum().round(9).unique().to_list() == [1.0]
    assert lists["concentration"].list.len().unique().to_list() == [2]


def test_sweep_points_share_their_runs(small: Path, tmp_path: Path) -> None:
    """Sweep points are labelled, and see the same seeds, environments and variables."""
    folder = folder_of(run(small, tmp_path, "sweep={arms.APEL.selector.decay: [0.0, 0.1]}", arms=("APEL",)))
    frame = pd.read_parquet(folder / "runs.parquet")
    labels = ["arms.APEL.selector.decay=0.0", "arms.APEL.selector.decay=0.1"]
    assert sorted(frame["sweep"].unique()) == labels
    one, other = (frame[frame["sweep"] == label].reset_index() for label in labels)
    assert one[["seed", "dropped", "optimal_length"]].equals(other[["seed", "dropped", "optimal_length"]])
    assert not one["steps"].equals(other["steps"])


@pytest.mark.parametrize("shard_size", [1, 100])
@pytest.mark.parametrize(
    ("overrides", "column", "expected"),
    [
        (
            ["sweep={eps: {learners.Q_full.exploration: [0.1, {start: 0.9, end: 0.1, steps: 50}]}}"],
            "eps",
            {"0.1", '{"start": 0.9, "end": 0.1, "steps": 50}'},
        ),
        (["variables={dropped: [x, 1]}"], "dropped", {"x", "1"}),
        (["sweep={nu: {arms.APEL.selector.decay: [0, 0.5]}}"], "nu", {0.0, 0.5}),
    ],
)
def test_values_of_several_types(
    small: Path, tmp_path: Path, overrides: list[str], column: str, expected: set[object], shard_size: int
) -> None:
    """A variable or an axis may take numbers and words or mappings: its column is text then, however shards are cut."""
    few = ("episodes=5", *overrides)
    folder = folder_of(run(small, tmp_path, *few, arms=("APEL",), shard_size=shard_size))
    assert set(pd.read_parquet(folder / "runs.parquet")[column]) == expected


def test_manifest(small: Path, tmp_path: Path) -> None:
    """The manifest holds what the results rest on; seeds are the golden ones."""
    folder = folder_of(run(small, tmp_path))
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["run_seeds"][:3] == [1892932127, 501869158, 32175636]
    (session,) = manifest["sessions"]
    assert session["placement"] == "local"
    assert set(session["arms"]) == {"Q_full", "APEL", "SSBAS"}
    assert session["versions"]["numpy"]


def test_spec_in_the_results_gives_the_same(small: Path, tmp_path: Path) -> None:
    """The stored spec, overrides included, has the identity of its folder."""
    outcome = run(small, tmp_path, "arms.APEL.selector.decay=0.5")
    store = ResultStore.at(str(folder_of(outcome)))
    assert store.experiment().identity == folder_of(outcome).name


def test_failed_run_is_named(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A failing run ends in exit code 1 and a line with its seed, learner and episode; the other arms are stored."""
    overrides = [
        "environment={id: 'tests.user_code:Corridor', options: {fault: raise, episode: 10}}",
        "learners={Q: {type: q_learning}}",
        "arms={One: {learners: [Q]}}",
        "variables={}",
        "criterion=null",
    ]
    words = [part for override in overrides for part in ("--set", override)]
    code, error = call(capsys, "run", str(small), "--placement", "local", "--results", str(tmp_path), *words)
    assert code == 1
    assert "6 run(s) failed: OSError: the motor is stuck at seed 1892932127 (run 0), learner Q, episode 10" in error
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("name", "placement"), [pytest.param("SIGINT", "actors", marks=pytest.mark.ray), ("SIGTERM", "local")]
)
def test_interrupted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, name: str, placement: str
) -> None:
    """An interrupted job ends with 130, leaves no process, and the same command completes it."""
    slow = write_slow(tmp_path)
    command = ["run", "slow.yaml", "--results", "results", "--set", "episodes=20", "--runs", "40", "--shard-size", "1"]
    here = [sys.executable, "-m", "jobs", *command, "--placement", placement]
    here += ["--cpus", "2"] if placement == "actors" else []
    pipe = subprocess.PIPE
    with started(here, cwd=tmp_path, stdout=pipe, stderr=pipe) as job:
        deadline = time.monotonic() + 600
        while len(list(tmp_path.rglob("parts/*/*.parquet"))) < 3:
            assert job.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        job.send_signal(getattr(signal, name))
        _, error = job.communicate(timeout=300)
    assert job.returncode == 130
    assert "interrupted" in error
    assert "Traceback" not in error
    folder = next(tmp_path.rglob("runs.parquet")).parent
    assert 3 <= len(pd.read_parquet(folder / "runs.parquet")) < 40
    assert len(pd.read_parquet(folder / "summary.parquet")) == 1
    slow.unlink()
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert call(capsys, *command, "--placement", "local", "--quiet") == (0, "")
    assert len(pd.read_parquet(folder / "runs.parquet")) == 40


def test_goes_on_from_checkpoints_of_another_cut(small: Path, tmp_path: Path) -> None:
    """An interrupted job that is given more runs, and so other shards, goes on where its shards have come to."""
    execution = Execution(streak_episodes=1, checkpoint_seconds=0.0, progress_seconds=0.0)
    few = Settings(results=str(tmp_path / "cut"), placement="local", arms=("APEL",), shard_size=4, execution=execution)
    calls = itertools.count()
    stopped = run_experiment(load_experiment(str(small)), few, stopping=lambda: next(calls) > 3)
    assert stopped.was_stopped
    (checkpoint,) = (tmp_path / "cut").rglob("*.npz")
    assert checkpoint.stem == "000000-000003"
    more, size = load_experiment(str(small), ["runs=9"]), {"shard_size": 100}
    outcome = run_experiment(more, replace(few, **size))
    parts = {path.stem for path in (tmp_path / "cut").rglob("parts/*/*.parquet")}
    assert parts == {"000000-000003", "000004-000008"}
    assert not list((tmp_path / "cut").rglob("*.npz"))
    whole = run_experiment(more, replace(few, **size, results=str(tmp_path / "whole")))
    assert_same(folder_of(whole), folder_of(outcome))
