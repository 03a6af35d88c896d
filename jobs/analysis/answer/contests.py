"""Who is compared with whom: candidates are arms, at those sweep points that stand for a choice of ours."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from jobs.experiment.axes import LABEL
from jobs.experiment.spec import Experiment
from jobs.experiment.sweep import ArmPoint, arm_points

_CHOICES = ("arms.", "learners.")
"""What an axis has to change for its values to be candidates; any other changes the task."""


@dataclass(frozen=True)
class Candidate:
    """What one might use."""

    name: str
    point: ArmPoint

    @property
    def learners(self) -> list[str]:
        """Names of its learners, repeated ones numbered."""
        names = self.point.spec.learner_names
        return [name if names.count(name) == 1 else f"{name}#{names[:i].count(name)}" for i, name in enumerate(names)]


@dataclass(frozen=True)
class Contest:
    """Candidates for one task; ``task`` is what distinguishes it from others of the sweep, empty where there is one."""

    task: str
    candidates: tuple[Candidate, ...]

    def only(self, arms: Collection[str] | None) -> Contest:
        """The same without the candidates of other arms; None: as it is."""
        if arms is None:
            return self
        return Contest(self.task, tuple(one for one in self.candidates if one.point.arm in arms))


def contests(experiment: Experiment) -> list[Contest]:
    """Who is compared with whom, in the order of the file."""
    found: dict[str, list[Candidate]] = {}
    choices = {axis for axis, values in experiment.sweep.items() if _is_choice(axis, values)}
    for one in arm_points(experiment):
        chosen, given = (_text(one.point.values, choices, among=among) for among in (True, False))
        name = f"{one.arm} [{chosen}]" if chosen else one.arm
        found.setdefault(given, []).append(Candidate(name, one))
    return [Contest(task, tuple(candidates)) for task, candidates in found.items()]


def _is_choice(axis: str, values: Any) -> bool:
    paths = [axis] if isinstance(values, list) else [path for path in values if path != LABEL]
    return all(path.startswith(_CHOICES) for path in paths)


def _text(values: Mapping[str, Any], choices: set[str], *, among: bool) -> str:
    return ", ".join(f"{axis}={value}" for axis, value in values.items() if (axis in choices) is among)
