"""Observations of several finite variables: vectors for tables, one-hot vectors for networks."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import FlattenObservation
from hypothesis import given
from hypothesis import strategies as st

import apel
from apel.experience.joint_space import JointSpace, is_joint
from apel.experience.observation_form import BorderError
from apel.experience.representations import Representation, View
from apel.learners.deep.encoding import Encoder

_LEAVES = st.one_of(
    st.builds(lambda n, start: spaces.Discrete(n, start=start), st.integers(1, 5), st.integers(-3, 3)),
    st.builds(lambda n: spaces.MultiDiscrete([n, 3], start=[1, -1]), st.integers(1, 4)),
    st.builds(spaces.MultiBinary, st.sampled_from([2, [2, 2]])),
)


def _nested(parts: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.one_of(
        st.lists(parts, min_size=1, max_size=3).map(spaces.Tuple),
        st.dictionaries(st.sampled_from(["b", "a", "hand"]), parts, min_size=1).map(spaces.Dict),
    )


@given(_nested(st.recursive(_LEAVES, _nested, max_leaves=4)), st.integers(0, 1000))
def test_vectors_and_networks(parts: Any, seed: int) -> None:
    """A vector is in its space, one for each observation; a network sees what flattening would have shown it."""
    assert is_joint(parts)
    parts.seed(seed)
    joint = JointSpace(parts)
    one, other = parts.sample(), parts.sample()
    vectors = [joint.vector(one), joint.vector(other)]
    assert all(vector in joint for vector in vectors)
    flat = [spaces.flatten(parts, observation) for observation in (one, other)]
    assert np.array_equal(*vectors) == np.array_equal(*flat)
    assert len(joint.features) == len(set(joint.features)) == len(joint.nvec)
    if not any(isinstance(leaf, spaces.MultiBinary) for leaf in _leaves(parts)):
        assert Encoder(joint)(vectors[0][None]).tolist() == [flat[0].tolist()]


def _leaves(space: Any) -> list[Any]:
    match space:
        case spaces.Tuple() | spaces.Dict():
            parts = space.values() if isinstance(space, spaces.Dict) else space
            return [leaf for part in parts for leaf in _leaves(part)]
    return [space]


def test_names() -> None:
    """By position and by key."""
    parts = spaces.Dict({"hand": spaces.MultiDiscrete([3, 4]), "ace": spaces.Tuple([spaces.Discrete(2)])})
    joint = JointSpace(parts)
    named = dict(zip(joint.features, joint.nvec.tolist(), strict=True))
    assert named == {"hand.0": 3, "hand.1": 4, "ace.0": 2}


@pytest.mark.parametrize(
    "space",
    [
        spaces.Discrete(3),
        spaces.MultiDiscrete([3]),
        spaces.Tuple([]),
        spaces.Tuple([spaces.Discrete(3), spaces.Box(0, 1)]),
        spaces.Dict({"a": spaces.Tuple([spaces.Text(3)])}),
    ],
)
def test_others_are_none(space: Any) -> None:
    """What is a state already, empty, or not finite."""
    assert not is_joint(space)


def test_left_out_variables_keep_their_first_values() -> None:
    """Of variables that are counted from elsewhere than 0 the rest is, too; networks still see one-hot vectors."""
    joint = JointSpace(spaces.Tuple([spaces.Discrete(3, start=5), spaces.Discrete(2), spaces.Discrete(4, start=-1)]))
    view = View(Representation(exclude=("1",)), joint, joint.features)
    space: Any = view.space
    assert (space.nvec.tolist(), space.start.tolist()) == ([3, 4], [5, -1])
    assert view(np.array([6, 1, 2])).tolist() == [6, 2]
    assert Encoder(space)(np.array([[6, 2]])).tolist() == [[0, 1, 0, 0, 0, 0, 1]]
    plain: Any = View(Representation(exclude=(0,)), spaces.MultiDiscrete([3, 4], start=[5, -1])).space
    assert (type(plain), plain.start.tolist()) == (spaces.MultiDiscrete, [-1])


def test_q_learning_plays_blackjack() -> None:
    """A tuple of three numbers is a state; one of them may be left out."""
    world = apel.make_world(apel.EnvironmentConfig("Blackjack-v1"), 1)
    learners = [
        apel.LearnerConfig("q_learning"),
        apel.LearnerConfig("q_learning", representation=Representation(exclude=(2,))),
    ]
    ensemble = apel.Ensemble(world, learners, apel.Uniform(), seed=1, num_episodes=60)
    assert {record.episode_return for record in ensemble.run()} <= {-1.0, 0.0, 1.0, 1.5}
    tables: Any = [learner.table for learner in ensemble.learners]  # type: ignore[attr-defined]
    assert [{len(key) for key in table} for table in tables] == [{3}, {2}]
    space = gymnasium.make("Blackjack-v1").observation_space
    assert all(tuple(map(int, key)) in space for key in tables[0])


def test_networks_see_blackjack_as_before() -> None:
    """45 numbers, one-hot: rows of networks do not depend on how tables see it."""
    plain = FlattenObservation(gymnasium.make("Blackjack-v1"))
    world = apel.make_world(apel.EnvironmentConfig("Blackjack-v1"), 1)
    encoder = Encoder(world.environment.observation_space)
    for seed in range(5):
        seen = world.environment.reset(seed=seed)[0]
        assert encoder(seen[None]).tolist() == [plain.reset(seed=seed)[0].tolist()]


_PAIR = spaces.Tuple([spaces.Discrete(3), spaces.Discrete(2)])
_HAND = spaces.Dict({"hand": spaces.MultiDiscrete([3, 3]), "rest": spaces.Tuple([spaces.MultiBinary(2)])})


@pytest.mark.parametrize(
    ("parts", "observation", "expected"),
    [
        (_PAIR, (1.9, 0), r"^0: .*1\.9 cannot be stored as int64 without loss"),
        (_PAIR, (1, 0, 5), r"found the observation \(1, 0, 5\).*it is no tuple of 2"),
        (_PAIR, (1,), "it is no tuple of 2"),
        (_PAIR, 1, "it is no tuple of 2"),
        (_PAIR, {0: 1, 1: 0}, "it is no tuple of 2"),
        (_PAIR, (1, [0, 1]), r"^1: .*it has the shape \(2,\), not \(\)"),
        (_PAIR, (1, "0"), "^1: .*it holds something that is no number"),
        (_HAND, {"hand": [1, 2, 0], "rest": ([1],)}, r"^hand: .*it has the shape \(3,\), not \(2,\)"),
        (_HAND, {"hand": [1, 2], "rest": ([1, 0.5],)}, r"^rest\.0: .*0\.5 cannot be stored as int8 without loss"),
        (_HAND, {"hand": [1, 2], "rest": ()}, "^rest: .*it is no tuple of 1"),
        (_HAND, {"hand": [1, 2]}, "it has no 'rest'"),
        (_HAND, ([1, 2], ([1, 0],)), "it has no 'hand'"),
    ],
)
def test_bad_parts(parts: Any, observation: Any, expected: str) -> None:
    """Parts are neither cut nor do they slide into each other: what is none of the space's is refused, and where."""
    with pytest.raises(BorderError, match=expected):
        JointSpace(parts).vector(observation)


@pytest.mark.parametrize(
    ("parts", "observation", "expected"),
    [
        (_PAIR, [2, True], [2, 1]),
        (_PAIR, np.array([2.0, 1.0]), [2, 1]),
        (_HAND, {"hand": (1, 2), "rest": [[True, False]], "more": 7}, [1, 2, 1, 0]),
    ],
)
def test_parts_in_other_forms(parts: Any, observation: Any, expected: list[int]) -> None:
    """What says the same is the same, as everywhere else; a Dict may hold more than is declared."""
    assert JointSpace(parts).vector(observation).tolist() == expected


class Cards(gymnasium.Env[Any, int]):
    """Shows a pair."""

    observation_space: Any = _PAIR
    action_space: Any = spaces.Discrete(2)

    def __init__(self, shown: Any) -> None:
        self._shown = shown

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        return (0, 0), {}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self._shown, 0.0, True, False, {}


@pytest.mark.parametrize(
    ("shown", "expected"), [((1.9, 0), "step 1: 0: found"), ((7, 0), r"step 1: .*7 at \[0\] is not from 0 to 2")]
)
def test_runs_refuse_bad_parts(shown: Any, expected: str) -> None:
    """A run ends with the step that was wrong, whether its parts cannot be converted or lie outside of the space."""
    world = apel.make_world(apel.EnvironmentConfig(Cards, {"shown": shown}), 1)
    ensemble = apel.Ensemble(world, [apel.LearnerConfig("q_learning")], apel.Uniform(), seed=1, num_episodes=2)
    with pytest.raises(ValueError, match=expected):
        list(ensemble.run())
