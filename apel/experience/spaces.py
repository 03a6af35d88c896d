"""The spaces of an environment as its learners need them, and as a state tree that can be stored."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from gymnasium import spaces

from apel.experience.channels import ChannelSpace
from apel.experience.joint_space import JointSpace
from apel.experience.parts import FlattenedSpace
from apel.numerics.state_trees import StateError

_USUAL: Final = np.dtype(np.int64)
"""Of Discrete spaces, where nothing else is stored."""


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
            return {"kind": "channels", "parts": _named_trees(space), "signals": list(space.signals)}
        case JointSpace():
            return {"kind": "joint", "of": _tree(space.parts)}
        case FlattenedSpace():
            return _flattened_tree(space)
        case spaces.Dict():
            return {"kind": "dict", "parts": _named_trees(space)}
        case spaces.Tuple() | spaces.OneOf():
            kind = "tuple" if isinstance(space, spaces.Tuple) else "one_of"
            return {"kind": kind, "parts": [_tree(part) for part in space.spaces]}
    return _plain_tree(space)


def _plain_tree(space: Any) -> dict[str, Any]:
    """Of a space without parts. What most are goes without saying, so that the agents of before keep their digests."""
    match space:
        case spaces.Discrete():
            number = {} if space.dtype == _USUAL else {"type": str(space.dtype)}
            return {"kind": "discrete", "n": int(space.n), "start": int(space.start), **number}
        case spaces.MultiDiscrete():
            return {"kind": "multi_discrete", "nvec": space.nvec, "start": space.start, "type": str(space.dtype)}
        case spaces.MultiBinary():
            return _binary_tree(space)
        case spaces.Text():
            lengths = {"min_length": space.min_length, "max_length": space.max_length}
            return {"kind": "text", **lengths, "characters": "".join(space.character_list)}
        case spaces.Box():
            return _box_tree(space)
    message = f"found the space {space}, expected one of those that can be stored"
    raise StateError(message)


def _named_trees(space: spaces.Dict) -> list[list[Any]]:
    return [[name, _tree(part)] for name, part in space.items()]


def _box_tree(space: spaces.Box) -> dict[str, Any]:
    return {"kind": "box", "low": space.low, "high": space.high, "type": str(space.dtype)}


def _flattened_tree(space: FlattenedSpace) -> dict[str, Any]:
    """That of the vectors alone where a user's own space is among the parts."""
    try:
        parts = _tree(space.parts)
    except StateError:
        return _box_tree(space)
    return {"kind": "flattened", "of": parts, "vectors": _box_tree(space)}


def _binary_tree(space: spaces.MultiBinary) -> dict[str, Any]:
    """A row of bits may be told by its length or by its shape, which Gymnasium holds to be different."""
    shape = list(space.shape)
    is_row_by_shape = len(shape) == 1 and not isinstance(space.n, int)
    return {"kind": "multi_binary", "shape": shape, **({"by": "shape"} if is_row_by_shape else {})}


def _space(tree: dict[str, Any]) -> spaces.Space[Any]:
    match tree["kind"]:
        case "channels":
            return ChannelSpace(_named_spaces(tree["parts"]), tree["signals"])
        case "joint":
            parts: Any = _space(tree["of"])
            return JointSpace(parts)
        case "flattened":
            vectors: Any = _space(tree["vectors"])
            return FlattenedSpace(_space(tree["of"]), vectors)
        case "dict":
            return _named_spaces(tree["parts"])
        case "tuple":
            return spaces.Tuple([_space(part) for part in tree["parts"]])
        case "one_of":
            return spaces.OneOf([_space(part) for part in tree["parts"]])
    return _plain_space(tree)


def _plain_space(tree: dict[str, Any]) -> spaces.Space[Any]:
    number: Any = np.dtype(tree.get("type", _USUAL)).type
    match tree["kind"]:
        case "discrete":
            # Not every version of Gymnasium knows others than the usual ones.
            other: Any = {"dtype": number} if "type" in tree else {}
            return spaces.Discrete(tree["n"], start=tree["start"], **other)
        case "multi_discrete":
            return spaces.MultiDiscrete(np.array(tree["nvec"]), dtype=number, start=np.array(tree["start"]))
        case "multi_binary":
            is_by_length = len(tree["shape"]) == 1 and "by" not in tree
            return spaces.MultiBinary(tree["shape"][0] if is_by_length else tree["shape"])
        case "text":
            return spaces.Text(tree["max_length"], min_length=tree["min_length"], charset=tree["characters"])
        case "box":
            return spaces.Box(np.array(tree["low"]), np.array(tree["high"]), dtype=number)
    raise KeyError(tree["kind"])


def _named_spaces(parts: list[Any]) -> spaces.Dict:
    """In the order in which they are stored, which a vector made of them depends on."""
    return spaces.Dict([(name, _space(part)) for name, part in parts])
