"""What an environment's `reset` and `step` answer, unpacked and checked in one place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np

from apel.experience.observation_form import BorderError, plain_number, shown

_NEW_RESET = "expected the two of Gymnasium's: observation, info (in old Gym it was the observation alone)"
_NEW_STEP = (
    "expected the five of Gymnasium's: observation, reward, terminated, truncated, info (in old Gym there were four, "
    "with a single end)"
)


def reset(environment: gymnasium.Env[Any, Any], seed: int) -> tuple[Any, Mapping[str, Any]]:
    """Start an episode: observation and info.

    Raises
    ------
    BorderError
        If the answer is of another form. What the environment raises is raised.
    """
    try:
        answer: Any = environment.reset(seed=seed)
    except ValueError as error:
        if _is_of_unpacking(error):
            message = f"reset() returned something else than two things, {_NEW_RESET}"
            raise BorderError(message) from error
        raise
    if not isinstance(answer, tuple) or len(answer) != 2 or not isinstance(answer[1], Mapping):
        message = f"reset() returned {shown(answer)}, {_NEW_RESET}"
        raise BorderError(message)
    return answer


def step(environment: gymnasium.Env[Any, Any], action: Any) -> tuple[Any, float, bool, bool]:
    """Play an action of the environment's: observation, reward, terminated, truncated.

    Raises
    ------
    BorderError
        If the answer is of another form. What the environment raises is raised.
    """
    try:
        answer: Any = environment.step(action)
    except ValueError as error:
        if _is_of_unpacking(error):
            message = f"step() returned another number of things, {_NEW_STEP}"
            raise BorderError(message) from error
        raise
    if not isinstance(answer, tuple | list) or len(answer) != 5:
        count = f"{len(answer)} things" if isinstance(answer, tuple | list) else shown(answer)
        message = f"step() returned {count}, {_NEW_STEP}"
        raise BorderError(message)
    observation, reward, terminated, truncated, _ = answer
    if type(reward) is not float or not math.isfinite(reward):
        reward = plain_number(reward, "reward")
    if type(terminated) is not bool:
        terminated = _truth("terminated", terminated)
    if type(truncated) is not bool:
        truncated = _truth("truncated", truncated)
    return observation, reward, terminated, truncated


def _truth(name: str, end: Any) -> bool:
    """An end as a plain truth value."""
    value = end.item() if isinstance(end, np.generic) or (isinstance(end, np.ndarray) and end.shape == ()) else end
    if isinstance(value, bool) or (isinstance(value, int) and value in (0, 1)):
        return bool(value)
    message = f"found {name} = {shown(end)}, expected True or False"
    raise BorderError(message)


def _is_of_unpacking(error: ValueError) -> bool:
    """Whether it came of a wrapper of Gymnasium's that could not unpack what it wraps returned."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    inside = trace is not None and str(trace.tb_frame.f_globals.get("__name__", "")).startswith("gymnasium.wrappers")
    return inside and "values to unpack" in str(error)
