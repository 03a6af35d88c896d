"""From the axes of a sweep to its points: where each arm is played."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jobs.experiment.axes import LABEL, axis_columns, may_touch
from jobs.experiment.paths import changed
from jobs.experiment.spec import Experiment, validate
from jobs.experiment.spec_parts import ArmSpec
from jobs.experiment.swept_values import axis_labels
from jobs.experiment.yaml_source import Source, SpecError


@dataclass(frozen=True)
class SweepPoint:
    """One combination of the swept values; the label is empty where nothing is swept."""

    label: str
    values: Mapping[str, Any]
    """By the name of the axis."""
    experiment: Experiment


@dataclass(frozen=True)
class ArmPoint:
    """An arm at a sweep point: what is played once for every run."""

    arm: str
    point: SweepPoint

    @property
    def spec(self) -> ArmSpec:
        """The arm, as it is at this point."""
        return self.point.experiment.arms[self.arm]

    @property
    def num_learners(self) -> int:
        """Learners of the arm."""
        return len(self.spec.learner_names)


@dataclass(frozen=True)
class _Axis:
    name: str
    levels: tuple[Mapping[str, Any], ...]
    """What to set at each place of the axis: values by path."""
    labels: tuple[Any, ...]
    """What stands for each level: its label, or the value of its first path."""


def arm_points(experiment: Experiment) -> tuple[ArmPoint, ...]:
    """Every arm at every sweep point that concerns it, in the order of the file.

    Raises
    ------
    SpecError
        If a combination of swept values is not a valid experiment.
    """
    content = {name: value for name, value in experiment.content().items() if name not in ("sweep", "plots")}
    points: dict[Sequence[tuple[str, int]], SweepPoint] = {}
    found: dict[tuple[str, str], ArmPoint] = {}
    for arm in experiment.arms:
        concerned = _concerned(experiment, arm, content)
        for places in itertools.product(*(range(len(axis.levels)) for axis in concerned)):
            chosen = list(zip(concerned, places, strict=True))
            label = ", ".join(f"{axis.name}={axis.labels[place]}" for axis, place in chosen)
            if (arm, label) in found:
                message = f"{experiment.where('sweep')}: found two sweep points called {label!r}, expected other labels"
                raise SpecError(message)
            key = tuple((axis.name, place) for axis, place in chosen)
            if key not in points:
                points[key] = _point(experiment, content, label, chosen)
            found[arm, label] = ArmPoint(arm, points[key])
    return tuple(found.values())


def _axes(experiment: Experiment) -> list[_Axis]:
    axes = []
    for name, values in experiment.sweep.items():
        columns = dict(axis_columns(name, values))
        labels = axis_labels(columns)
        columns.pop(LABEL, None)
        rows = zip(*columns.values(), strict=True)
        axes.append(_Axis(name, tuple(dict(zip(columns, row, strict=True)) for row in rows), tuple(labels)))
    return axes


def _concerned(experiment: Experiment, arm: str, content: dict[str, Any]) -> list[_Axis]:
    """The axes that make a difference to an arm; an axis of a single level is part of every arm's label."""
    axes = _axes(experiment)
    touching = [axis for axis in axes if may_touch(axis.name, experiment.sweep[axis.name], arm)]
    return [
        axis
        for axis in axes
        if len(axis.levels) == 1 or (axis in touching and _concerns(axis, touching, arm, content, experiment))
    ]


def _concerns(axis: _Axis, axes: Collection[_Axis], arm: str, content: dict[str, Any], experiment: Experiment) -> bool:
    """Whether the values of an axis make any difference to an arm, wherever it stands on the other axes."""
    for levels in itertools.product(*(other.levels for other in axes if other is not axis)):
        base = content
        for level in levels:
            base = _changed(base, level, experiment)
        # Values that are all alike to the arm make a difference too, where they are not those of the file.
        concerning = _concerning(base, arm)
        if any(_concerning(_changed(base, level, experiment), arm) != concerning for level in axis.levels):
            return True
    return False


def _concerning(content: dict[str, Any], arm: str) -> dict[str, Any]:
    """The part of an experiment that an arm depends on, of whatever kind swept values have made of it."""
    learners, arm_content = content["learners"], _entry(content["arms"], arm)
    names = _names(_entry(arm_content, "learners"))
    names |= {member for name in names for member in _names(_entry(_entry(learners, name), "members"))}
    return {**content, "arms": arm_content, "learners": {name: _entry(learners, name) for name in names}}


def _entry(node: Any, name: str) -> Any:
    return node.get(name) if isinstance(node, dict) else node


def _names(node: Any) -> set[str]:
    return {name for name in node if isinstance(name, str)} if isinstance(node, list | dict) else set()


def _changed(content: dict[str, Any], level: Mapping[str, Any], experiment: Experiment) -> dict[str, Any]:
    try:
        for path, value in level.items():
            content = changed(content, path, value)
    except KeyError as error:
        message = f"{experiment.where('sweep')}: {error.args[0]}"
        raise SpecError(message) from error
    return content


def _point(
    experiment: Experiment, content: dict[str, Any], label: str, chosen: Sequence[tuple[_Axis, int]]
) -> SweepPoint:
    if not chosen:
        return SweepPoint("", {}, experiment)
    for axis, place in chosen:
        content = _changed(content, axis.levels[place], experiment)
    values = {axis.name: axis.labels[place] for axis, place in chosen}
    where = experiment.where("sweep").removesuffix("sweep")
    return SweepPoint(label, values, validate(Source(f"{where}sweep point {label}", content), experiment._parts))
