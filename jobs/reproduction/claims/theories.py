"""What theory says at each point of a claim's axis; every constant of it is the experiment's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from apel.theory import closed_forms, selection_aware
from apel.theory.adaptation import WindowCriterion
from jobs.analysis.adaptation_model import mean_adaptation_time, window_criterion
from jobs.analysis.statistics.bootstrap import Floats
from jobs.experiment.axes import LABEL
from jobs.experiment.spec import Experiment
from jobs.reproduction.claims.selection import Selection, UnknownNameError


@dataclass(frozen=True)
class Setting:
    """What a theory is told of the arm that it is held against.

    Attributes
    ----------
    axis:
        ``float64[points]``: the points, counted from where a theory's own axis begins.
    decays:
        ``float64[points]``: ν at each of them.
    num_learners:
        Of the arm.
    criterion:
        That of the measured adaptation time, with the lengths of both learners' episodes; None where the experiment
        does not state them.
    """

    axis: Floats
    decays: Floats
    num_learners: int = 2
    criterion: WindowCriterion | None = None


Prediction = Callable[[Setting, Floats], Floats]
"""From the setting and the measured locations ``[…, arms, points]`` to ``[…, points]``."""


def _at_each(function: Callable[[float, int], float]) -> Prediction:
    return lambda setting, _: np.array([function(float(nu), setting.num_learners) for nu in setting.decays])


def _performance(share_of_others: Callable[[float, int], float]) -> Prediction:
    """Of the ensemble (arm 0) from the measured returns of its learners alone (arms 1 and 2)."""

    def predict(setting: Setting, location: Floats) -> Floats:
        explored = np.array([share_of_others(float(nu), setting.num_learners) for nu in setting.decays])
        return (1 - explored) * location[..., 1, :] + explored * location[..., 2, :]

    return predict


def _growth(setting: Setting, _: Floats) -> Floats:
    """Eq. 3.7 over episodes, at the one decay of the arm."""
    return closed_forms.incremented_concentration(float(setting.decays[0]), setting.axis)


def _measured_adaptation(setting: Setting, _: Floats) -> Floats:
    criterion, count = setting.criterion, setting.num_learners
    if criterion is None:
        message = "theory: found an experiment that does not state how long its learners' episodes are, expected that"
        raise UnknownNameError(message)
    return np.array([mean_adaptation_time(float(nu), count, criterion) for nu in setting.decays])


THEORIES: dict[str, Prediction] = {
    "concentration_formula": _at_each(lambda nu, _: closed_forms.steady_state_concentration(nu)),
    "concentration_model": _at_each(selection_aware.steady_state_concentration),
    "adaptation_formula": _at_each(lambda nu, _: closed_forms.adaptation_time(nu)),
    "adaptation_model": _at_each(selection_aware.adaptation_time),
    "adaptation_window_model": _measured_adaptation,
    "performance_formula": _performance(closed_forms.exploration_probability),
    "performance_model": _performance(selection_aware.exploration_probability),
    "growth_formula": _growth,
}


def setting_of(experiment: Experiment, selection: Selection, points: Floats, since: str | None) -> Setting:
    """The setting of a claim's first arm.

    Parameters
    ----------
    experiment, selection:
        Which one, and what the claim asks of it.
    points:
        Of the claim's axis.
    since:
        The field of the experiment, by its path, that says where the axis begins for the theory; None for 0.

    Raises
    ------
    UnknownNameError
        If the experiment has no such field, or does not say which decay it is.
    """
    arm = selection.arms[0]
    start = 0.0 if since is None else _number(experiment, since)
    return Setting(
        points - start,
        _decays(experiment, selection, points),
        len(experiment.arms[arm].learner_names),
        window_criterion(experiment, arm),
    )


def _decays(experiment: Experiment, selection: Selection, points: Floats) -> Floats:
    """The arm's decay at each point: that of the sweep, or else the one that stands in the file."""
    path = f"arms.{selection.arms[0]}.selector.decay"
    for axis, swept in experiment.sweep.items():
        columns = swept if isinstance(swept, dict) else {axis: swept}
        if path not in columns:
            continue
        names = columns.get(LABEL) or next(iter(columns.values()))
        if axis == selection.axis:
            found = [columns[path][names.index(point)] for point in points.tolist()]
            return np.array(found, dtype=np.float64)
        if axis not in selection.where:
            message = f"theory: found several decays, expected {axis!r} in where or as the axis"
            raise UnknownNameError(message)
        return np.full(len(points), float(columns[path][names.index(selection.where[axis])]))
    return np.full(len(points), _number(experiment, path))


def _number(experiment: Experiment, path: str) -> float:
    found: Any = experiment.model_dump(mode="json")
    for part in path.split("."):
        found = found.get(part) if isinstance(found, dict) else None
    if not isinstance(found, int | float):
        message = f"theory: found {found!r} as {path} of {experiment.name}, expected a number"
        raise UnknownNameError(message)
    return float(found)
