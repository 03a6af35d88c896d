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
from jobs.spec import LABEL, ArmSpec, Experiment, representation_of, set_path, validate
from jobs.yaml_source import Source, SpecError

RunKey = tuple[str, str, int]
"""Arm, sweep label, run index."""


@dataclass(frozen=True)
class SweepPoint:
    """One combination of the swept values; the label is empty where nothing is swept."""

    label: str
    values: Mapping[str, Any]
    """By the name of the axis."""
    experiment: Experiment


@dataclass(frozen=True)
class _Axis:
    name: str
    settings: tuple[Mapping[str, Any], ...]
    """What to set at each place of the axis: values by path."""
    labels: tuple[Any, ...]
    """What stands for each place: its label, or the value of its first path."""


def _axes(experiment: Experiment) -> list[_Axis]:
    axes = []
    for name, values in experiment.sweep.items():
        columns = {name: values} if isinstance(values, list) else dict(values)
        labels = columns.pop(LABEL, None) or next(iter(columns.values()))
        rows = zip(*columns.values(), strict=True)
        axes.append(_Axis(name, tuple(dict(zip(columns, row, strict=True)) for row in rows), tuple(labels)))
    return axes


def arm_points(experiment: Experiment, arms: Collection[str] | None) -> list[tuple[SweepPoint, str]]:
    """Every arm (of ``arms``; None: of all) at every sweep point that concerns it, in the order of the file.

    Raises
    ------
    SpecError
        If a combination of swept values is not a valid experiment.
    """
    content = experiment.model_dump(mode="json", exclude={"sweep", "plots"}, exclude_none=True)
    axes, points = _axes(experiment), {}
    wanted = []
    for arm in experiment.arms if arms is None else [arm for arm in experiment.arms if arm in arms]:
        concerned = [axis for axis in axes if _concerns(axis, axes, arm, content)]
        for places in itertools.product(*(range(len(axis.settings)) for axis in concerned)):
            chosen = list(zip(concerned, places, strict=True))
            label = ", ".join(f"{axis.name}={axis.labels[place]}" for axis, place in chosen)
            if label not in points:
                points[label] = _point(experiment, content, label, chosen)
            wanted.append((points[label], arm))
    return wanted


def _concerns(axis: _Axis, axes: Sequence[_Axis], arm: str, content: dict[str, Any]) -> bool:
    """Whether the values of an axis make any difference to an arm, wherever it stands on the other axes."""
    if len(axis.settings) == 1:
        return True
    for places in itertools.product(*(other.settings for other in axes if other is not axis)):
        base = content
        for settings in places:
            base = _changed(base, settings)
        # Values that are all alike to the arm make a difference too, where they are not those of the file.
        if any(_concerning(_changed(base, settings), arm) != _concerning(base, arm) for settings in axis.settings):
            return True
    return False


def _concerning(content: dict[str, Any], arm: str) -> dict[str, Any]:
    """The part of an experiment that an arm depends on."""
    learners = content["learners"]
    names = set(content["arms"].get(arm, {}).get("learners", ()))
    names |= {member for name in names for member in learners.get(name, {}).get("members", ())}
    used = {name: learners.get(name) for name in names}
    return {**content, "arms": content["arms"].get(arm), "learners": used}


def _changed(content: dict[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    changed = copy.deepcopy(content)
    try:
        for path, value in settings.items():
            set_path(changed, path, value)
    except KeyError as error:
        message = f"sweep: {error.args[0]}"
        raise SpecError(message) from error
    return changed


def _point(
    experiment: Experiment, content: dict[str, Any], label: str, chosen: Sequence[tuple[_Axis, int]]
) -> SweepPoint:
    if not chosen:
        return SweepPoint("", {}, experiment)
    for axis, place in chosen:
        content = _changed(content, axis.settings[place])
    values = {axis.name: axis.labels[place] for axis, place in chosen}
    return SweepPoint(label, values, validate(Source(f"sweep point {label}", content)))


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
    num_ensembles = sum(len(point.experiment.arms[arm].learner_names) > 1 for point, arm in points)
    for point, arm in points:
        num_learners = len(point.experiment.arms[arm].learner_names)
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
        learner_names=_distinct(spec.learner_names),
        selector=_selector(spec),
        performance=experiment.performance,
        num_episodes=experiment.episodes,
        num_steps=experiment.steps,
        criterion=experiment.criterion,
        stops_when_met=experiment.stop_when_met,
        steady_state_episodes=experiment.steady_state_episodes or 0,
        recording=experiment.record,
        sweep_values=point.values,
        learner_gpus=_gpus(experiment, spec),
    )


def _gpus(experiment: Experiment, spec: ArmSpec) -> tuple[float, ...]:
    shares = tuple(experiment.learners[name].num_gpus for name in spec.learner_names)
    return shares if any(shares) else ()


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
        learners=tuple(_learner(experiment, name, variables) for name in experiment.arms[arm].learner_names),
        variables=variables,
    )


def draw_variables(experiment: Experiment, run_seed: int) -> dict[str, Any]:
    """One value of each variable; each has a stream of its own, so that appending one moves no other."""
    drawn = {}
    for position, (name, values) in enumerate(experiment.variables.items()):
        generator = np.random.default_rng(seed_sequence(run_seed, Role.VARIABLES, position))
        drawn[name] = values[int(generator.integers(len(values)))]
    return drawn


def _learner(experiment: Experiment, name: str, variables: Mapping[str, Any]) -> LearnerConfig:
    spec = experiment.learners[name]
    representation = representation_of(spec, _fill(spec.representation, variables))
    members = tuple(_learner(experiment, member, variables) for member in spec.members)
    return LearnerConfig(spec.type, _fill(spec.options, variables), representation, members)


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
