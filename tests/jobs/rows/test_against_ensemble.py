"""The whole of it against `apel.Ensemble`, for two runs of every arm of every shipped tabular experiment.

A job in local placement must store the rows, value for value, that Algorithm 5 gives when it is run by hand from the
same plan. Every arm is held against it at the first and the last value of each axis of the sweep, and at every reading
of the text. What makes the shipped experiments long is shortened, and nothing else: 16 episodes in mazes of 5 × 5 cells
with 30 steps at most (no such maze has an optimal length of 33 moves, so none is asked for), switches after 5 episodes,
at most 3 copies of a learner, and a criterion with a window of 3 episodes that some runs meet.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from apel import Ensemble
from apel.building import make_selector
from apel.numerics.seeding import run_seeds
from cluster.learner_host import make_run_world
from cluster.shard import ArmPlan, RunPlan
from jobs.experiment.axes import LABEL
from jobs.experiment.plan import Plan
from jobs.experiment.run_plans import arm_plan, run_plan
from jobs.experiment.spec import Experiment, validate
from jobs.experiment.spec_files import shipped_experiments
from jobs.experiment.yaml_source import Source
from jobs.runner import Settings, run_experiment
from tests.apel.rounds import assert_same_rows, row_of
from tests.same_rows import folder_of

RUNS, EPISODES, SWITCH, COPIES = 2, 16, 5, 3
HEADER = ("probability", "performance_estimate", "concentration")
Key = tuple[str, str, int]
"""Arm, sweep label, run."""
Rows = dict[Key, list[tuple[float, ...]]]


def shortened(name: str) -> Experiment:
    """A shipped experiment that takes a second."""
    content = yaml.safe_load(shipped_experiments()[name])
    content |= {"runs": RUNS, "episodes": EPISODES, "record": "all"}
    if "switch" in content.get("variables", {}):
        content["variables"]["switch"] = [SWITCH - 1, SWITCH]
    options = content["environment"]["options"]
    options |= {"size": 5, "max_steps": 30}
    options.pop("optimal_length", None)
    if "criterion" in content:
        content["criterion"] |= {"window": 3, "below": content["criterion"]["below"] | {"factor": 2.5}}
        if isinstance(content["criterion"].get("after"), int):
            content["criterion"]["after"] = SWITCH
    if "steady_state_episodes" in content:
        content["steady_state_episodes"] = 4
    for learner in content["learners"].values():
        if isinstance(learner.get("exploration"), dict) and isinstance(learner["exploration"]["episode"], int):
            learner["exploration"]["episode"] = SWITCH
    for arm in content["arms"].values():
        if isinstance(arm["learners"], dict):
            arm["learners"] = {learner: min(count, COPIES) for learner, count in arm["learners"].items()}
    content["sweep"] = {axis: shortened_axis(axis, values) for axis, values in content.get("sweep", {}).items()}
    return validate(Source(name, content))


def shortened_axis(axis: str, values: list[Any] | dict[str, list[Any]]) -> dict[str, list[Any]]:
    """An axis with its first and last place; with all of them where they have labels."""
    columns = {axis: values} if isinstance(values, list) else values
    places = slice(None) if LABEL in columns else slice(0, None, max(len(next(iter(columns.values()))) - 1, 1))
    return {path: shortened_column(path, column[places]) for path, column in columns.items()}


def shortened_column(path: str, values: list[Any]) -> list[Any]:
    """What a path is set to at the places of its axis."""
    if path == "criterion.after" or path.endswith(".exploration.episode"):
        return [*range(SWITCH - len(values) + 1, SWITCH + 1)]
    if path == "variables.switch":
        return [[SWITCH - 1, SWITCH] for _ in values]
    if path == "episodes":
        return [*range(EPISODES - len(values) + 1, EPISODES + 1)]
    if path.startswith("arms.") and ".learners." in path:
        return [min(value, COPIES) for value in values]
    return values


def played_by_hand(arm: ArmPlan, run: RunPlan) -> Ensemble:
    """The ensemble of a run. One that goes on when it has met the criterion plays as if there were none."""
    return Ensemble(
        make_run_world(run),
        run.learners,
        make_selector(arm.selector),
        run.seed,
        arm.num_episodes,
        performance=arm.performance,
        criterion=arm.criterion.of_run(run.variables) if arm.criterion and arm.stops_when_met else None,
    )


def by_hand(experiment: Experiment) -> tuple[Rows, dict[Key, int | None]]:
    """The rows and train times of all runs, one after the other through `Ensemble`."""
    rows: Rows = {}
    times: dict[Key, int | None] = {}
    seeds = run_seeds(experiment.seed, experiment.runs)
    for one in Plan.of(experiment).arm_points:
        arm = arm_plan(one)
        for index, seed in enumerate(seeds):
            key = one.arm, one.point.label, index
            ensemble = played_by_hand(arm, run_plan(one, index, seed))
            rows[key] = [row_of(record) for record in ensemble.run()]
            if arm.stops_when_met:
                times[key] = ensemble.train_time
    return rows, times


def stored_row(row: Mapping[str, Any]) -> tuple[float, ...]:
    """A stored row as `row_of` has it."""
    header = [np.nan if value is None else value for name in HEADER for value in row[name]]
    return (row["episode"], row["selected"], row["return"], row["length"], *header)


def stored(folder: Path) -> Rows:
    """The rows of a job."""
    rows: Rows = {}
    for row in pq.read_table(folder / "episodes").to_pylist():
        rows.setdefault((row["arm"], row["sweep"], row["run_index"]), []).append(stored_row(row))
    return rows


@pytest.mark.parametrize("name", shipped_experiments("tabular"))
def test_job_gives_the_rows_of_algorithm_5(tmp_path: Path, name: str) -> None:
    """Episode, selected, return, length, probability, estimate and concentration are equal; so are the train times."""
    experiment = shortened(name)
    outcome = run_experiment(experiment, Settings(results=str(tmp_path), placement="local"))
    assert outcome.failures == []
    rows, times = by_hand(experiment)
    assert {arm for arm, _, _ in rows} == set(experiment.arms)
    assert_same_rows(stored(folder_of(outcome)), rows)
    runs = {(row["arm"], row["sweep"], row["run_index"]): row for row in outcome.store.runs().to_pylist()}
    for key, played in rows.items():
        assert runs[key]["episodes"] == len(played)
        assert runs[key]["steps"] == sum(length for _, _, _, length, *_ in played)
        if key in times and not runs[key]["censored"]:
            assert runs[key]["train_time"] == times[key]


def test_some_runs_meet_the_criterion_and_some_do_not() -> None:
    """What was shortened still ends in both ways."""
    _, times = by_hand(shortened("model-based"))
    assert {time is None for time in times.values()} == {True, False}
