"""What a plain learner answers: checked in one place, so that what is wrong is said of the learner that said it."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.experience.action_form import ActionForm, density_of
from apel.experience.observation_form import shown

_TOLERANCE = 1e-4
"""Of the sum of probabilities: those of a softmax in ``float16`` miss 1 by less."""


def action_of(answer: Any, form: ActionForm) -> int | NDArray[Any]:
    """The action that a learner answered, as banks have it (`apel.experience.action_form`).

    A discrete one is a whole number, or an array without dimensions that is one.

    Raises
    ------
    ValueError
        If it is none of the environment's.
    """
    return _number_of(answer, form) if form.is_discrete else form.converted(answer)


def mu_of(answer: Any, form: ActionForm) -> NDArray[np.float64] | float:
    """What a learner answered of the probabilities of its actions, or of the density of the one that it took.

    Raises
    ------
    ValueError
        If it is none.
    """
    return probabilities_of(answer, form.width) if form.is_discrete else density_of(answer)


def _number_of(answer: Any, form: ActionForm) -> int:
    try:
        action = (
            answer if type(answer) is int else operator.index(bool(answer) if isinstance(answer, np.bool_) else answer)
        )
    except TypeError as error:
        shape = f" of shape {answer.shape}" if isinstance(answer, np.ndarray) else ""
        message = f"found the action {shown(answer)}{shape}, expected a whole number, one of {form.space}"
        raise ValueError(message) from error
    counted = action - form.first
    if not 0 <= counted < form.width:
        message = f"found the action {shown(answer)}, expected one of {form.space}"
        raise ValueError(message)
    return counted


def pair_of(answer: Any) -> tuple[Any, Any]:
    """Action and probabilities.

    Raises
    ------
    ValueError
        If ``act`` answered something else.
    """
    if not isinstance(answer, tuple | list) or len(answer) != 2:
        message = f"act() returned {shown(answer)}, expected two things: an action, and its probabilities or None"
        raise ValueError(message)
    return answer[0], answer[1]


def action_values_of(answer: Any, count: int) -> NDArray[np.float64]:
    """What a learner thinks of ``count`` actions; infinite values are values.

    Raises
    ------
    ValueError
        If it is something else.
    """
    values = _numbers(answer, count, "action values")
    if np.isnan(values).any():
        message = f"found the action values {shown(values.tolist())}, expected {count} numbers"
        raise ValueError(message)
    return values


def probabilities_of(answer: Any, count: int) -> NDArray[np.float64]:
    """The probabilities of ``count`` actions that a learner answered.

    Raises
    ------
    ValueError
        If they are none.
    """
    row = _numbers(answer, count, "probabilities")
    values = row.tolist()
    if min(values) >= 0.0 and abs(sum(values) - 1.0) <= _TOLERANCE:  # NaN makes the sum NaN
        return row
    if not np.isfinite(row).all():
        why = "finite numbers"
    elif (row < 0.0).any():
        why = "none below 0 (logarithms are no probabilities)"
    else:
        why = f"a sum of 1 instead of {row.sum():.6g}"
    message = f"found the probabilities {shown(values)}, expected {why}"
    raise ValueError(message)


def _numbers(answer: Any, count: int, name: str) -> NDArray[np.float64]:
    try:
        numbers = np.asarray(answer, dtype=np.float64)
    except (TypeError, ValueError) as error:
        message = f"found the {name} {shown(answer)}, expected {count} numbers"
        raise ValueError(message) from error
    if numbers.shape != (count,):
        message = f"found the {name} {shown(answer)} of shape {numbers.shape}, expected ({count},)"
        raise ValueError(message)
    return numbers
