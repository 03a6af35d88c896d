"""Closing environments: some have a process, a window or a socket of their own, which only they can end."""

from __future__ import annotations

import atexit
import weakref
from collections.abc import Iterable
from typing import Any

import gymnasium

from apel.run.user_code import is_interruption

_OPEN: weakref.WeakValueDictionary[int, gymnasium.Env[Any, Any]] = weakref.WeakValueDictionary()
"""To be closed at the latest where the process ends."""


def keep_open(environment: gymnasium.Env[Any, Any], instead_of: gymnasium.Env[Any, Any] | None = None) -> None:
    """Remember that this one is to be closed; a wrapper closes what it wraps, and stands ``instead_of`` it."""
    if instead_of is not None:
        _OPEN.pop(id(instead_of), None)
    _OPEN[id(environment)] = environment


def close_environment(environment: gymnasium.Env[Any, Any]) -> None:
    """Close it, once. What it raises then is passed over, since no row depends on it."""
    if _OPEN.pop(id(environment), None) is None:
        return
    try:
        environment.close()
    except BaseException as error:
        if is_interruption(error):
            raise


def close_environments(environments: Iterable[gymnasium.Env[Any, Any]]) -> None:
    """Close several."""
    for environment in environments:
        close_environment(environment)


@atexit.register
def _close_what_is_open() -> None:
    close_environments(list(_OPEN.values()))
