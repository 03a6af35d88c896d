"""From an experiment to shards: a decision, without any effect."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
from apel.seeding import Role, run_seeds, seed_sequence
from cluster.shard import ArmPlan, RunPlan, Shard
from jobs.spec import ArmSpec, Experiment, LearnerSpec, representation_of, set_path, validate
from jobs.yaml_source import Source, SpecError

RunKey = tuple[str, str, int]
"""Arm, sweep label, run index."""


@dataclass(frozen=True)
class SweepPoint:
    """One combination of the swept values; the label is empty where nothing is swept."""

    label: str
    experiment: Experiment


def sweep_points(experiment: Experiment) -> list[SweepPoint]:
    """Every combination of the swept values, each a valid experiment of its own.

    Raises
    ------
    SpecError
        If a combination is not valid.
    """
    points = []
    for values in itertools.product(*experiment.sweep.values()):
        content = copy.deepcopy(experiment.model_dump(mode="json", exclude={"sweep"}, exclude_none=True))
        settings = list(zip(experiment.sweep, values, strict=True))
        label = ", ".join(f"{path}={value}" for path, value in settings)
        try:
            for path, value in settings:
                set_path(content, path, value)
        except KeyError as error:
            message = f"sweep: {error.args[0]}"
            raise SpecError(message) from error
        points.append(SweepPoint(label, validate(Source(f"sweep point {label}", content)) if settings else experiment))
    return points


def arm_points(experiment: Experiment, arms: Collection[str] | None) -> list[tuple[SweepPoint, str]]:
    """Every arm (of ``arms``; None: of all) at every sweep point, in the order of the file."""
    return [
        (point, arm)
        for point in sweep_points(experiment)
        for arm in point.experiment.arms
        if arms is None or arm in arms
    ]


def plan_shards(
    experiment: Experiment,
    shard_size: int | None,
    arms: Collection[str] | None,
    finished: Collection[RunKey],
    num_cpus: int,
) -> list[Shard]:
    """The shards of all runs that are not ``finished``: those of the arms with most learners first.

    Runs are cut at multiples of the shard size, so that an interrupted job finds its checkpoints again. Without a
    shard size see `default_shard_size`.
    """
    shards = []
    seeds = run_seeds(experiment.seed, experiment.runs)
    points = arm_points(experiment, arms)
    num_ensembles = sum(len(point.experiment.arms[arm].learners) > 1 for point, arm in points)
    for point, arm in points:
        num_learners = len(point.experiment.arms[arm].learners)
        size = shard_size or default_shard_size(experiment.runs, num_cpus, num_learners, num_ensembles)
        missing = [i for i in range(experiment.runs) if (arm, point.label, i) not in finished]
        plan = arm_plan(point, arm)
        for _, group in itertools.groupby(missing, key=lambda index, size=size: index // size):  # type: ignore[misc]
            shards.append(Shard(plan, tuple(run_plan(point.experiment, arm, i, seeds[i]) for i in group)))
    return sorted(shards, key=lambda shard: -len(shard.arm.learner_names))


def default_shard_size(num_runs: int, num_cpus: int, num_learners: int, num_ensembles: int) -> int:
    """How many runs to play side by side; at most 100.

    The runs of an ensemble share the cost of its messages, so its shards are as large as can be with one for every
    CPU. A learner alone sends none: its shards are small, and fill up the CPUs towards the end of the job.
    """
    shards_per_arm = -(-num_cpus // num_ensembles) if num_learners > 1 else 2 * num_cpus
    return min(max(-(-num_runs // shards_per_arm), 1), 100)


def arm_plan(point: SweepPoint, arm: str) -> ArmPlan:
    """What all runs of an arm share."""
    experiment = point.experiment
    spec = experiment.arms[arm]
    return ArmPlan(
        experiment=experiment.name,
        arm=arm,
        sweep=point.label,
        learner_names=_distinct(spec.learners),
        selector=_selector(spec),
        performance=experiment.performance,
        num_episodes=experiment.episodes,
        criterion=experiment.criterion,
        stops_when_met=experiment.stop_when_met,
        recording=experiment.record,
    )


def run_plan(experiment: Experiment, arm: str, index: int, seed: int) -> RunPlan:
    """One run; all arms of a run share its seed, and so its environment and its variables.

    Raises
    ------
    ValueError
        If an option cannot be filled in.
    """
    variables = draw_variables(experiment, seed)
    environment = experiment.environment
    return RunPlan(
        index=index,
        seed=seed,
        environment=EnvironmentConfig(
            environment.id, _fill(environment.options, variables), environment.run_seed, environment.max_episode_steps
        ),
        learners=tuple(_learner(experiment.learners[name], variables) for name in experiment.arms[arm].learners),
        variables=variables,
    )


def draw_variables(experiment: Experiment, run_seed: int) -> dict[str, Any]:
    """One value of each variable; each has a stream of its own, so that appending one moves no other."""
    drawn = {}
    for position, (name, values) in enumerate(experiment.variables.items()):
        generator = np.random.default_rng(seed_sequence(run_seed, Role.VARIABLES, position))
        drawn[name] = values[int(generator.integers(len(values)))]
    return drawn


def _learner(spec: LearnerSpec, variables: Mapping[str, Any]) -> LearnerConfig:
    representation = representation_of(spec, _fill(spec.representation, variables))
    return LearnerConfig(spec.type, _fill(spec.options, variables), representation)


def _selector(spec: ArmSpec) -> SelectorConfig:
    if spec.selector is None:
        return SelectorConfig("fixed")
    return SelectorConfig(spec.selector.type, spec.selector.options)


def _distinct(names: Sequence[str]) -> tuple[str, ...]:
    """Names of an arm's learners; repeated ones are numbered."""
    return tuple(name if names.count(name) == 1 else f"{name}#{names[:i].count(name)}" for i, name in enumerate(names))


def _fill(node: Any, variables: Mapping[str, Any]) -> Any:
    """Replace every ``$name`` by the value drawn for it."""
    if isinstance(node, dict):
        return {key: _fill(value, variables) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_fill(value, variables) for value in node]
    if isinstance(node, str) and node.startswith("$"):
        if node[1:] not in variables:
            message = f"found {node!r}, expected one of the variables {sorted(variables)}"
            raise ValueError(message)
        return variables[node[1:]]
    return node


def all_run_keys(experiment: Experiment, arms: Collection[str] | None) -> Iterator[RunKey]:
    """Every run of the experiment."""
    for point, arm in arm_points(experiment, arms):
        for index in range(experiment.runs):
            yield arm, point.label, index
