"""Spaces as state trees: each comes back equal, with all that Gymnasium's equality does not look at."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.spaces.utils import flatten_space
from hypothesis import given
from hypothesis import strategies as st

from apel.experience.channels import ChannelSpace
from apel.experience.joint_space import JointSpace, is_joint
from apel.experience.parts import FlattenedSpace, parts_of
from apel.experience.spaces import Spaces, spaces_of, spaces_tree
from apel.numerics.state_trees import StateError, pack, unpack

_WHOLE = st.sampled_from([np.int64, np.int32, np.int16, np.int8])
_SHAPES = st.lists(st.integers(1, 3), min_size=1, max_size=3)


def _box(kind: Any, shape: list[int], low: float, high: float) -> spaces.Box:
    return spaces.Box(np.full(shape, low, kind), np.full(shape, high, kind), dtype=kind)


_PLAIN = st.one_of(
    st.builds(
        lambda n, start, kind: spaces.Discrete(n, start=start, dtype=kind),
        st.integers(1, 9),
        st.integers(-9, 9),
        _WHOLE,
    ),
    st.builds(
        lambda nvec, start, kind: spaces.MultiDiscrete(nvec, dtype=kind, start=np.full_like(nvec, start)),
        _SHAPES.map(np.array) | st.just(np.array([[2, 3], [4, 5]])),
        st.integers(-9, 9),
        _WHOLE,
    ),
    st.builds(spaces.MultiBinary, st.integers(1, 4) | _SHAPES),
    st.builds(_box, st.sampled_from([np.float32, np.float64, np.float16]), _SHAPES, st.just(-np.inf), st.floats(0, 9)),
    st.builds(_box, st.sampled_from([np.uint8, np.int32]), st.just([]) | _SHAPES, st.just(0), st.integers(1, 99)),
)
_LEAVES = _PLAIN | st.builds(
    lambda length, characters: spaces.Text(length, min_length=0, charset=characters),
    st.integers(1, 4),
    st.text(min_size=1),
)


def _named(parts: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Dicts with keys in any order."""
    keys = st.sampled_from(["b", "a", "hand", "C"])
    return st.dictionaries(keys, parts, min_size=1).map(lambda given: spaces.Dict(list(given.items())))


def _nested(parts: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.lists(parts, min_size=1, max_size=3).map(spaces.Tuple) | _named(parts)


def _seen(parts: Any) -> Any:
    """As an environment with such observations is made for learners."""
    vectors: Any = None if is_joint(parts) else flatten_space(parts)
    return JointSpace(parts) if vectors is None else FlattenedSpace(parts, vectors)


_WITH_PARTS = _nested(st.recursive(_LEAVES, _nested, max_leaves=5))
_CHOICES = st.lists(_LEAVES | _WITH_PARTS, min_size=1, max_size=2).map(spaces.OneOf)
_CHANNELS = _named(_PLAIN).map(lambda parts: ChannelSpace(parts, ["own"]))


@given(_PLAIN | _WITH_PARTS | _CHOICES | _WITH_PARTS.map(_seen) | _CHANNELS, _PLAIN)
def test_spaces_come_back(observation: Any, action: Any) -> None:
    """Equal, of one kind, with equal parts in the same order, and with the same bytes when they are stored again."""
    stored = pack(spaces_tree(Spaces(observation, action, ("x",))))
    found = spaces_of(unpack(stored))
    assert found == Spaces(observation, action, ("x",))
    assert type(found.observation) is type(observation)
    assert parts_of(found.observation) == parts_of(observation)
    assert repr(found.observation) == repr(observation)
    assert pack(spaces_tree(found)) == stored


@pytest.mark.parametrize(
    ("tree", "expected"),
    [
        ({"kind": "discrete", "n": 3, "start": 1}, spaces.Discrete(3, start=1)),
        ({"kind": "multi_binary", "shape": [3]}, spaces.MultiBinary(3)),
        ({"kind": "multi_binary", "shape": [2, 3]}, spaces.MultiBinary([2, 3])),
        ({"kind": "box", "low": np.zeros(2), "high": np.ones(2), "type": "float64"}, _box(np.float64, [2], 0, 1)),
        (
            {"kind": "dict", "parts": [["a", {"kind": "discrete", "n": 2, "start": 0}]]},
            spaces.Dict({"a": spaces.Discrete(2)}),
        ),
    ],
)
def test_spaces_of_before(tree: dict[str, Any], expected: Any) -> None:
    """What older versions stored is read, and stored as it was, so that the agents of before keep their digests."""
    action = {"kind": "discrete", "n": 2, "start": 0}
    stored = {"observation": tree, "action": action, "features": None}
    found = spaces_of(stored)
    assert found == Spaces(expected, spaces.Discrete(2), None)
    assert pack(spaces_tree(found)) == pack(stored)


class Own(spaces.Space[Any]):
    """A space that nobody else knows."""


def test_spaces_that_cannot_be_stored() -> None:
    """They are refused by name; of what was made a vector with one among its parts, there is the vector."""
    with pytest.raises(StateError, match="expected one of those that can be stored"):
        spaces_tree(Spaces(Own(), spaces.Discrete(2), None))
    vectors = _box(np.float32, [3], 0, 1)
    seen = FlattenedSpace(spaces.Dict({"mine": Own()}), vectors)
    found = spaces_of(spaces_tree(Spaces(seen, spaces.Discrete(2), None)))
    assert (found.observation, type(found.observation)) == (vectors, spaces.Box)
    with pytest.raises(StateError, match="found no spaces of an environment"):
        spaces_of({"observation": {"kind": "sphere"}, "action": {"kind": "discrete"}, "features": None})
