"""Spaces as stable-baselines3 wants them: discrete values counted from 0, in vectors, and Boxes with dimensions."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from gymnasium import spaces


def check_actions(space: Any) -> None:
    """Refuse actions that no algorithm could choose.

    Raises
    ------
    ValueError
        If they are neither Discrete nor real numbers between finite bounds.
    """
    if isinstance(space, spaces.Discrete):
        return
    if not isinstance(space, spaces.Box):
        message = f"found the action space {space}, expected a Discrete one or a Box"
        raise ValueError(message)
    if space.dtype.kind != "f" or not space.is_bounded() or not (space.low < space.high).all() or not space.shape:
        message = f"found the action space {space}, expected real numbers, each between two finite bounds"
        raise ValueError(message)


def sb3_action_space(space: Any) -> Any:
    """Actions as SB3 knows them; a copy, since it seeds the space and draws from it."""
    return spaces.Discrete(int(space.n)) if isinstance(space, spaces.Discrete) else copy.deepcopy(space)


def sb3_observation_space(space: spaces.Space[Any]) -> spaces.Space[Any]:
    """Observations as SB3 sees them.

    Raises
    ------
    ValueError
        If it is neither a plain space nor a Dict of plain ones.
    """
    if isinstance(space, spaces.Dict):
        return spaces.Dict({name: _plain(part) for name, part in space.items()})
    return _plain(space)


def sb3_observation(space: spaces.Space[Any], observation: Any) -> Any:
    """An observation of ``space`` as an element of `sb3_observation_space`."""
    match space:
        case spaces.Dict():
            return {name: sb3_observation(part, observation[name]) for name, part in space.items()}
        case spaces.Discrete():
            return observation - space.start
        case spaces.MultiDiscrete():
            return np.ravel(observation - space.start)
        case spaces.Box(shape=()):
            return np.reshape(observation, 1)
    return observation


def _plain(space: spaces.Space[Any]) -> spaces.Space[Any]:
    match space:
        case spaces.Discrete():
            return spaces.Discrete(int(space.n))
        case spaces.MultiDiscrete():
            return spaces.MultiDiscrete(space.nvec.ravel())
        case spaces.Box(shape=()):
            return spaces.Box(space.low.reshape(1), space.high.reshape(1), dtype=space.dtype.type)
        case spaces.Box() | spaces.MultiBinary():
            return copy.deepcopy(space)
    message = f"found the observation space {space}, expected Box, Discrete, MultiDiscrete, MultiBinary"
    raise ValueError(message)
