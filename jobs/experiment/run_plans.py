"""What is sent to those who play: an arm at a sweep point, and each of its runs with the variables drawn for it."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
from apel.numerics.near_names import did_you_mean
from apel.numerics.seeding import Role, seed_sequence
from cluster.shard import ArmPlan, RunPlan
from jobs.experiment.spec import Experiment, representation_of
from jobs.experiment.spec_parts import ArmSpec
from jobs.experiment.starts import start_of, start_paths
from jobs.experiment.sweep import ArmPoint


class OptionError(ValueError):
    """Options that cannot be filled in, and the field that they are options of."""

    def __init__(self, place: tuple[str, ...], message: str) -> None:
        super().__init__(message)
        self.place = place


def arm_plan(arm_point: ArmPoint) -> ArmPlan:
    """What all runs of an arm at a sweep point share."""
    experiment, spec = arm_point.point.experiment, arm_point.spec
    return ArmPlan(
        experiment=experiment.name,
        arm=arm_point.arm,
        sweep=arm_point.point.label,
        learner_names=_distinct(spec.learner_names),
        selector=_selector(experiment, spec),
        performance=experiment.made_by(experiment.performance),
        num_episodes=experiment.episodes,
        num_steps=experiment.steps,
        criterion=experiment.criterion,
        stops_when_met=experiment.stop_when_met,
        steady_state_episodes=experiment.steady_state_episodes or 0,
        recording=experiment.record,
        models=experiment.models,
        sweep_values=arm_point.point.values,
        learner_gpus=_gpus(experiment, spec),
    )


def run_plan(arm_point: ArmPoint, index: int, seed: int) -> RunPlan:
    """One run; all arms of a run share its seed, and so its environment and its variables.

    Raises
    ------
    OptionError
        If an option cannot be filled in, or a learner cannot begin with what it shall.
    """
    return with_starts(arm_point, fresh_run_plan(arm_point, index, seed))


def fresh_run_plan(arm_point: ArmPoint, index: int, seed: int) -> RunPlan:
    """The same run with learners that begin with nothing: no agent that they would begin with is read for it.

    Raises
    ------
    OptionError
        If an option cannot be filled in.
    """
    experiment = arm_point.point.experiment
    variables = draw_variables(experiment, seed)
    environment = experiment.environment
    return RunPlan(
        index=index,
        seed=seed,
        environment=EnvironmentConfig(
            experiment.made_by(environment.id),
            _filled(("environment",), environment.options, variables),
            environment.run_seed,
            environment.max_episode_steps,
            environment.observations,
        ),
        learners=tuple(_learner(experiment, name, variables) for name in arm_point.spec.learner_names),
        variables=variables,
    )


def with_starts(arm_point: ArmPoint, run: RunPlan) -> RunPlan:
    """A run of that arm, whose learners begin with what the experiment says.

    Raises
    ------
    OptionError
        If one cannot begin with it.
    """
    experiment, names = arm_point.point.experiment, arm_point.spec.learner_names
    if next(start_paths(experiment), None) is None:
        return run
    configs = []
    for name, numbered, config in zip(names, _distinct(names), run.learners, strict=True):
        try:
            start = start_of(experiment, arm_point.arm, name, numbered)
        except ValueError as error:
            raise OptionError(("learners", name), str(error)) from error
        configs.append(replace(config, start=start))
    return replace(run, learners=tuple(configs))


def draw_variables(experiment: Experiment, run_seed: int) -> dict[str, Any]:
    """One value of each variable; each has a stream of its own, so that appending one moves no other."""
    drawn = {}
    for position, (name, values) in enumerate(experiment.variables.items()):
        generator = np.random.default_rng(seed_sequence(run_seed, Role.VARIABLES, position))
        drawn[name] = values[int(generator.integers(len(values)))]
    return drawn


def _gpus(experiment: Experiment, spec: ArmSpec) -> tuple[float, ...]:
    shares = tuple(experiment.learners[name].num_gpus for name in spec.learner_names)
    return shares if any(shares) else ()


def _learner(experiment: Experiment, name: str, variables: Mapping[str, Any]) -> LearnerConfig:
    spec = experiment.learners[name]
    place = ("learners", name)
    try:
        representation = representation_of(spec, _filled(place, spec.representation, variables))
    except ValueError as error:
        raise OptionError(place, str(error)) from error
    for member in spec.members:
        if experiment.learners[member].start_from is not None:
            message = f"start_from: found it of a member of {name!r}, expected it of that which holds it"
            raise OptionError(("learners", member), message)
    members = tuple(_learner(experiment, member, variables) for member in spec.members)
    options = _filled(place, spec.options, variables)
    return LearnerConfig(experiment.made_by(spec.type), options, representation, members, spec.learns_from)


def _selector(experiment: Experiment, spec: ArmSpec) -> SelectorConfig:
    if spec.selector is None:
        return SelectorConfig("fixed")
    return SelectorConfig(experiment.made_by(spec.selector.type), spec.selector.options, spec.selector.acting_floor)


def _distinct(names: Sequence[str]) -> tuple[str, ...]:
    """Names of an arm's learners; repeated ones are numbered."""
    return tuple(name if names.count(name) == 1 else f"{name}#{names[:i].count(name)}" for i, name in enumerate(names))


def _filled(place: tuple[str, ...], options: Mapping[str, Any], variables: Mapping[str, Any]) -> dict[str, Any]:
    try:
        return {name: _fill(value, variables) for name, value in options.items()}
    except ValueError as error:
        raise OptionError(place, str(error)) from error


def _fill(node: Any, variables: Mapping[str, Any]) -> Any:
    """Replace every ``$name`` by the value drawn for it."""
    if isinstance(node, dict):
        return {key: _fill(value, variables) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_fill(value, variables) for value in node]
    if isinstance(node, str) and node.startswith("$"):
        if node[1:] not in variables:
            meant = did_you_mean(node[1:], variables)
            message = f"found {node!r}, expected one of the variables {sorted(variables)}{meant}"
            raise ValueError(message)
        # A copy: what one learner makes of it is no business of another.
        return copy.deepcopy(variables[node[1:]])
    return node
