from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from apel.experience.representations import Bins, Representation, View, state_rows

FEATURES = ("x", "y", "distractor")


@pytest.mark.parametrize(
    ("exclude", "seen"),
    [((), [0, 1, 2]), (("y",), [0, 2]), ((1,), [0, 2]), (("x", 2), [1]), (("y", 1), [0, 2])],
)
def test_exclusion_by_name_and_position(exclude: tuple[str | int, ...], seen: list[int]) -> None:
    """Features are left out by name or by position; naming one twice is harmless."""
    assert Representation(exclude=exclude).visible(FEATURES) == seen


@pytest.mark.parametrize("exclude", ["z", 3, -1, "0"])
def test_unknown_feature_is_refused(exclude: str | int) -> None:
    """Excluding what is not there is a mistake, and the message names what is there."""
    with pytest.raises(ValueError, match=r"exclude: found .*, expected one of \['x', 'y', 'distractor'\]"):
        Representation(exclude=(exclude,)).visible(FEATURES)


def test_something_must_be_left() -> None:
    """A learner that sees nothing is refused."""
    with pytest.raises(ValueError, match=r"exclude: found \['x', 1, 2\], expected at least one of"):
        Representation(exclude=("x", 1, 2)).visible(FEATURES)


@pytest.mark.parametrize(
    "options", [{"exclude": "y"}, {"exclude": (1.5,)}, {"hide": ("y",)}, {"bins": ({"low": 0.0, "count": 2},)}]
)
def test_representation_refuses_options_that_make_no_sense(options: dict[str, Any]) -> None:
    """Options are checked when a representation is made; a bare string is not a list of names."""
    with pytest.raises(ValueError, match=next(iter(options))):
        Representation(**options)


@pytest.mark.parametrize("value", [-1e300, 0.0, 2.0, math.inf])
def test_one_bin_ignores_the_feature(value: float) -> None:
    """With one bin every value is the same."""
    assert Bins(0.0, 1.0, 1).index(value) == 0


def test_two_bins_tell_low_from_high() -> None:
    """Two bins meet in the middle; values beyond the bounds fall into the nearer one."""
    bins = Bins(-2.4, 2.4, 2)
    assert [bins.index(value) for value in (-math.inf, -2.0, -0.1, 0.0, 0.1, 2.0, 9.0)] == [0, 0, 0, 1, 1, 1, 1]


def test_bins_are_equal() -> None:
    """Four bins on [0, 8] have their edges at 2, 4 and 6, which belong to the right."""
    bins = Bins(0.0, 8.0, 4)
    values = (-100.0, 0.0, 1.9, 2.0, 3.9, 4.0, 5.9, 6.0, 7.9, 8.0, 100.0)
    assert [bins.index(value) for value in values] == [0, 0, 0, 1, 1, 2, 2, 3, 3, 3, 3]


def test_bounds_of_bins_are_ordered() -> None:
    """Bounds the wrong way round are refused."""
    with pytest.raises(ValueError, match=r"found low 1\.0 and high -1\.0, expected low below high"):
        Bins(1.0, -1.0, 5)


@given(
    low=st.floats(-100, 99), width=st.floats(0.01, 100), count=st.integers(1, 12), values=st.lists(st.floats(-300, 300))
)
def test_bins_are_ordered_and_in_range(low: float, width: float, count: int, values: list[float]) -> None:
    """A larger value never falls into a lower bin, and every value falls into one of ``count``."""
    bins = Bins(low, low + width, count)
    indices = [bins.index(value) for value in sorted(values)]
    assert indices == sorted(indices)
    assert all(0 <= index < count for index in indices)


def test_bins_count_is_at_least_one() -> None:
    """No bins at all is refused."""
    with pytest.raises(ValueError, match="count"):
        Bins(low=0.0, high=1.0, count=0)


def test_view_without_options_changes_nothing() -> None:
    """The empty representation passes space and observation through, whatever they are."""
    for space in (spaces.Discrete(5), spaces.Box(0, 1, (2, 2)), spaces.MultiDiscrete([3, 4])):
        view = View(Representation(), space)
        observation = space.sample()
        assert view.space is space
        assert view(observation) is observation


def test_view_of_multidiscrete_leaves_features_out() -> None:
    """Space and observation lose the excluded features alike."""
    view = View(Representation(exclude=("y",)), spaces.MultiDiscrete([4, 5, 10]), FEATURES)
    assert view.space == spaces.MultiDiscrete([4, 10])
    assert view(np.array([3, 2, 9])).tolist() == [3, 9]


def test_view_of_box_leaves_features_out() -> None:
    """Bounds and type of a Box follow; without names the features are called feature_0, feature_1 and so on."""
    space = spaces.Box(np.array([-1.0, -2.0, -3.0]), np.array([1.0, 2.0, 3.0]), dtype=np.float64)
    view = View(Representation(exclude=("feature_0",)), space)
    assert view.space == spaces.Box(np.array([-2.0, -3.0]), np.array([2.0, 3.0]), dtype=np.float64)
    assert view(np.array([0.1, 0.2, 0.3])).tolist() == [0.2, 0.3]


def test_view_with_bins_makes_finitely_many_states() -> None:
    """A Box in bins is a MultiDiscrete space of as many values as bins; the excluded feature's bins fall away."""
    bins = (Bins(0.0, 1.0, 3), Bins(0.0, 1.0, 5), Bins(-1.0, 1.0, 1))
    space = spaces.Box(-2.0, 2.0, (3,))
    view = View(Representation(bins=bins, exclude=(1,)), space)
    assert view.space == spaces.MultiDiscrete([3, 1])
    assert view(np.array([1.5, 0.5, 0.5])).tolist() == [2, 0]
    assert view.space.contains(view(space.sample()))


@pytest.mark.parametrize(
    "space", [spaces.Box(0.0, 1.0, (3,)), spaces.MultiDiscrete([3, 3]), spaces.Discrete(2)], ids=str
)
def test_bins_must_fit_the_space(space: spaces.Space[Any]) -> None:
    """Bins need a Box and one entry per feature."""
    with pytest.raises(ValueError, match=r"bins: found 2 for .*, expected one per feature of a one-dimensional Box"):
        View(Representation(bins=(Bins(0.0, 1.0, 2), Bins(0.0, 1.0, 2))), space)


def test_features_of_other_spaces_cannot_be_left_out() -> None:
    """Where an observation has no separate features, exclusion is refused."""
    with pytest.raises(ValueError, match="exclude"):
        View(Representation(exclude=("state",)), spaces.Discrete(4))
    with pytest.raises(ValueError, match="MultiDiscrete and one-dimensional Box spaces only"):
        View(Representation(exclude=(0,)), spaces.MultiBinary(3))


@given(sizes=st.lists(st.integers(2, 4), min_size=1, max_size=4), data=st.data())
def test_states_share_a_row_iff_they_look_alike(sizes: list[int], data: st.DataObject) -> None:
    """Two states have one row if and only if they agree on all visible features; rows fit a table of that size."""
    names = [f"feature_{i}" for i in range(len(sizes))]
    hidden = data.draw(st.sets(st.sampled_from(range(len(sizes))), max_size=len(sizes) - 1))
    values = np.array(list(itertools.product(*(range(size) for size in sizes))))
    rows = state_rows(Representation(exclude=tuple(hidden)), names, values).tolist()
    seen = [tuple(int(v) for i, v in enumerate(value) if i not in hidden) for value in values]
    for one, other in itertools.combinations(range(len(rows)), 2):
        assert (rows[one] == rows[other]) == (seen[one] == seen[other])
    assert min(rows) >= 0
    assert max(rows) < len(set(seen))
