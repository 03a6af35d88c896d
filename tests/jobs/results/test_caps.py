"""Runs that never met their criterion count with the cap, whatever ended them, and are stored as they were."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from jobs.analysis.plotting.samples import samples, selected
from jobs.analysis.statistics import summarise
from jobs.analysis.stored_summary import stored_summary
from jobs.experiment.figures import ArmPlot, LinePlot
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import load_experiment, shipped_experiments
from jobs.reproduction.claims.samples import Results
from jobs.reproduction.claims.selection import Selection
from jobs.results.caps import counted_with_cap
from jobs.results.store import ResultStore
from jobs.runner import Settings, run_experiment

SWEEP = "sweep={cap: {episodes: [80, 60], learners.Q_red.exploration: [0.1, 0.2]}}"


def rows_of(*rows: tuple[str, str, int | None, bool | None]) -> pa.Table:
    """Arm, sweep, train time and whether it is censored; the criterion counts from episode 2 on."""
    arms, sweeps, times, censored = map(list, zip(*rows, strict=True))
    columns: dict[str, Any] = {
        "arm": arms,
        "sweep": sweeps,
        "run_index": [list(zip(arms, sweeps, strict=True))[:i].count(rows[i][:2]) for i in range(len(rows))],
        "train_time": pa.array(times, pa.int64()),
        "censored": pa.array(censored, pa.bool_()),
        "adaptation_time": pa.array([None if time is None else time - 2 for time in times], pa.int64()),
        "episodes": [80 if time is None else time for time in times],
        "steps": [300] * len(rows),
        "steady_state": pa.nulls(len(rows), pa.float64()),
    }
    return pa.table(columns)


ENDED = rows_of(("Q_full", "", 3, True), ("Q_full", "", 90, True), ("APEL", "", 20, False), ("APEL", "", 40, True))


@pytest.fixture
def experiment(small: Path) -> Experiment:
    """Runs of 80 episodes, or 300 steps."""
    return load_experiment(str(small), ["steps=300"])


@pytest.fixture
def store(experiment: Experiment, tmp_path: Path) -> ResultStore:
    """The results of an arm that never gets there, within few episodes, and of one that gets there or not."""
    store = ResultStore.at(str(tmp_path / "results"))
    store.folder.write("spec.yaml", experiment.to_yaml().encode())
    store.write_table("runs.parquet", ENDED)
    return store


def test_times_of_the_cap(experiment: Experiment) -> None:
    """At least the cap: 80, though steps ended the run after 3; runs that got there, and all else, stay as they are."""
    found = counted_with_cap(ENDED, experiment)
    assert found["train_time"].to_pylist() == [80, 90, 20, 80]
    assert found["adaptation_time"].to_pylist() == [78, 88, 18, 78]
    rest = [name for name in ENDED.column_names if not name.endswith("_time")]
    assert found.select(rest).equals(ENDED.select(rest))
    assert found.schema.equals(ENDED.schema)


def test_rows_that_do_not_know_a_time_stay_so(experiment: Experiment) -> None:
    """Without a criterion there is none, and without `steps` nothing but the cap ends a run."""
    unknown = rows_of(("Q_full", "", None, None), ("APEL", "", 3, True))
    assert counted_with_cap(unknown, experiment)["train_time"].to_pylist() == [None, 80]
    assert counted_with_cap(ENDED, experiment.model_copy(update={"steps": None})) is ENDED
    untyped = ENDED.drop_columns("censored").append_column("censored", pa.nulls(4))
    assert counted_with_cap(untyped, experiment) is untyped


def test_caps_of_sweep_points(small: Path) -> None:
    """Each its own; an arm of hindsight has that of the point that its rows are of."""
    experiment = load_experiment(str(small), [SWEEP, "steps=300", "hindsight={best: [APEL, SSBAS]}"])
    rows = rows_of(("APEL", "cap=80", 3, True), ("APEL", "cap=60", 3, True), ("best", "cap=60", 4, True))
    assert counted_with_cap(rows, experiment)["train_time"].to_pylist() == [80, 60, 60]


def test_swept_steps_end_runs_too(small: Path) -> None:
    experiment = load_experiment(str(small), ["sweep={steps: [300, 400]}"])
    rows = rows_of(("APEL", "steps=300", 3, True), ("APEL", "steps=400", 4, True))
    assert counted_with_cap(rows, experiment)["train_time"].to_pylist() == [80, 80]


def test_summary(store: ResultStore) -> None:
    """Means 85 and 50; one that was stored before, of the rows as they stand, is made anew."""
    store.write_summary(summarise(ENDED), ENDED)
    for _ in range(2):
        never, sometimes = stored_summary(store).to_pylist()
        assert (never["mean_train_time"], sometimes["mean_train_time"]) == (85, 50)
        assert (never["mean_adaptation_time"], never["num_censored"], sometimes["num_censored"]) == (83, 2, 1)
        counted = store.counted_runs()
        store.write_summary(summarise(counted), counted)


def test_summary_without_the_experiment(store: ResultStore) -> None:
    """The caps are not known: the rows as they stand are all that there is, which is said."""
    store.folder.write("spec.yaml", b"name: []")
    told: list[str] = []
    store.say = told.append
    assert stored_summary(store)["mean_train_time"].to_pylist() == [46.5, 30]
    assert [note.partition("spec.yaml: ")[2] for note in told] == [
        "found no experiment that can be read: if steps ended runs, times may be too short"
    ]


def test_figures(store: ResultStore, experiment: Experiment) -> None:
    """Means and distributions have the cap; how long a run was watched is what the share of solved ones rests on."""
    plots = [
        ArmPlot(kind="bars", name="a"),
        ArmPlot(kind="distributions", name="a"),
        ArmPlot(kind="survival", name="a"),
    ]
    plots.append(LinePlot(kind="lines", name="a", metric="train_time", x="decay"))  # type: ignore[arg-type]
    found = [
        [one.values.tolist() for one in samples(selected(ENDED, plot, experiment), "train_time")] for plot in plots
    ]
    assert found == [[[80, 90], [20, 80]]] * 2 + [[[3, 90], [20, 40]]] + [[[80, 90], [20, 80]]]


def test_claims(store: ResultStore, experiment: Experiment) -> None:
    selection = Selection(metric="train_time", arms=["Q_full", "APEL"], where={})
    found = Results(store, experiment).select(selection)
    assert found.sample.values[:, :, 0].tolist() == [[80, 20], [90, 80]]


def test_rows_of_a_job(small: Path, tmp_path: Path) -> None:
    """What is stored are the episodes that were played; the table of the job and that of its files count the cap."""
    small.write_text(small.read_text().replace("factor: 1.3", "factor: 0.1"))
    outcome = run_experiment(
        load_experiment(str(small), ["steps=300", "runs=2"]), Settings(results=str(tmp_path), placement="local")
    )
    rows = outcome.store.runs().to_pandas()
    assert (rows["train_time"] == rows["episodes"]).all()
    assert (rows["episodes"] < 80).all()
    assert outcome.summary is not None
    assert outcome.summary["mean_train_time"].to_pylist() == [80, 80, 80]
    assert outcome.store.summary().equals(outcome.summary)


@pytest.mark.parametrize("name", [*shipped_experiments()])
def test_shipped_experiments_end_with_one_of_both(name: str) -> None:
    """So that nothing that was published counts otherwise: where steps end runs, no criterion does."""
    experiment = load_experiment(name)
    assert experiment.criterion is None or experiment.steps is None
    assert "steps" not in experiment.sweep
