"""The learners of a shard begin with what others have learned, if that fits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gymnasium import spaces

from apel.configs import LearnerConfig, Start
from apel.experience.representations import Representation, View
from apel.experience.spaces import Spaces
from apel.learners.base import LearnerBank

_FORM_ERRORS = (ValueError, LookupError, TypeError, AttributeError, RuntimeError, ArithmeticError)


def begin_bank(bank: LearnerBank, configs: Sequence[LearnerConfig], seen: Sequence[Spaces]) -> None:
    """Let the learners of a bank, which have just been made, begin with what their configurations say.

    Raises
    ------
    ValueError
        If that is nothing that they can begin with.
    """
    starts = [config.start for config in configs if config.start is not None]
    if not starts:
        return
    for config, of_run in zip(configs, seen, strict=True):
        check_start(config, of_run)
    try:
        bank.begin_from([start.state for start in starts])
    except _FORM_ERRORS as error:
        found = error if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        message = f"start_from: {starts[0].name} does not fit the options of this learner: {found}"
        raise ValueError(message) from error


def check_start(config: LearnerConfig, here: Spaces) -> None:
    """See that a learner is of the kind of the one that it begins with, sees the same space, and has the same actions.

    Raises
    ------
    ValueError
        If it is not; the message says how they differ.
    """
    start = config.start
    if start is None:
        return
    if start.kind != config.name:
        message = f"start_from: {start.name} is of the type {start.kind!r}, expected {config.name!r}"
        raise ValueError(message)
    for what, found, expected in (
        ("actions", start.spaces.action, here.action),
        ("observations", _seen(start), _seen_by(config, here)),
    ):
        if found != expected:
            message = f"start_from: {start.name} has the {what} {found}, expected those of this learner, {expected}"
            raise ValueError(message)


def _seen(start: Start) -> list[spaces.Space[Any]]:
    return [_view(seen, start.spaces) for seen in start.representations]


def _seen_by(config: LearnerConfig, here: Spaces) -> list[spaces.Space[Any]]:
    return [_view(member.representation, here) for member in (config.members or (config,))]


def _view(representation: Representation, of: Spaces) -> spaces.Space[Any]:
    return View(representation, of.observation, of.features).space
