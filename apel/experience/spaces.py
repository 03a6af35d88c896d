"""The spaces of an environment as its learners need them, and as a state tree that can be stored."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from apel.experience.channels import ChannelSpace
from apel.experience.joint_space import JointSpace
from apel.numerics.state_trees import StateError


class Spaces(NamedTuple):
    """What the learners of an environment are made for."""

    observation: spaces.Space[Any]
    action: Any
    features: tuple[str, ...] | None
    """Names of the variables of an observation, where it has names."""


def spaces_tree(of: Spaces) -> dict[str, Any]:
    """The spaces as a state tree (`apel.numerics.state_trees`)."""
    return {
        "observation": _tree(of.observation),
        "action": _tree(of.action),
        "features": None if of.features is None else list(of.features),
    }


def spaces_of(tree: dict[str, Any]) -> Spaces:
    """What `spaces_tree` was given.

    Raises
    ------
    StateError
        If the tree is none.
    """
    try:
        features = tree["features"]
        return Spaces(
            _space(tree["observation"]), _space(tree["action"]), None if features is None else tuple(features)
        )
    except (KeyError, TypeError, ValueError, AssertionError, AttributeError) as error:
        message = f"found no spaces of an environment ({type(error).__name__}: {error}), expected some"
        raise StateError(message) from error


def _tree(space: Any) -> dict[str, Any]:
    match space:
        case ChannelSpace():
            channels = [[name, _tree(part)] for name, part in space.items()]
            return {"kind": "channels", "parts": channels, "signals": list(space.signals)}
        case JointSpace():
            return {"kind": "joint", "of": _tree(space.parts)}
        case spaces.Dict():
            return {"kind": "dict", "parts": [[name, _tree(part)] for name, part in space.items()]}
        case spaces.Tuple():
            return {"kind": "tuple", "parts": [_tree(part) for part in space.spaces]}
        case spaces.Discrete():
            return {"kind": "discrete", "n": int(space.n), "start": int(space.start)}
        case spaces.MultiDiscrete():
            return {"kind": "multi_discrete", "nvec": space.nvec, "start": space.start, "type": str(space.dtype)}
        case spaces.MultiBinary():
            return {"kind": "multi_binary", "shape": list(space.shape)}
        case spaces.Box():
            return {"kind": "box", "low": space.low, "high": space.high, "type": str(space.dtype)}
    message = f"found the space {space}, expected one of those that can be stored"
    raise StateError(message)


def _space(tree: dict[str, Any]) -> spaces.Space[Any]:
    match tree["kind"]:
        case "channels":
            channels = spaces.Dict({name: _space(part) for name, part in tree["parts"]})
            return ChannelSpace(channels, tree["signals"])
        case "joint":
            parts: Any = _space(tree["of"])
            return JointSpace(parts)
        case "dict":
            return spaces.Dict({name: _space(part) for name, part in tree["parts"]})
        case "tuple":
            return spaces.Tuple([_space(part) for part in tree["parts"]])
        case "discrete":
            return spaces.Discrete(tree["n"], start=tree["start"])
        case "multi_discrete":
            kind: Any = np.dtype(tree["type"]).type
            return spaces.MultiDiscrete(np.array(tree["nvec"]), dtype=kind, start=np.array(tree["start"]))
        case "multi_binary":
            return spaces.MultiBinary(tree["shape"])
        case "box":
            number: Any = np.dtype(tree["type"]).type
            return spaces.Box(np.array(tree["low"]), np.array(tree["high"]), dtype=number)
    raise KeyError(tree["kind"])
