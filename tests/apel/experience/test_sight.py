"""What learners are told of a step, where the runs of a shard see differently."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium import spaces

from apel.experience.channels import ChannelSpace
from apel.experience.representations import Bins, Representation, View, WholeView
from apel.experience.sight import Sight

FEATURES = ("x", "y", "z")
SPACE = spaces.MultiDiscrete([4, 5, 6])
CHANNELS = ChannelSpace(spaces.Dict({"n": spaces.Discrete(9), "v": spaces.Box(0, 9, (2,))}), ["bonus", "over"])


def entries(*rows: tuple[int, list[float], float, float]) -> np.ndarray:
    return np.array([(n, v, bonus, over) for n, v, bonus, over in rows], dtype=CHANNELS.entry_type)


def test_runs_that_see_alike_are_one_array() -> None:
    """Equal representations of equal spaces, whoever made the views."""
    sight = Sight([View(Representation(exclude=("y",)), SPACE, FEATURES) for _ in range(3)])
    seen = sight.start(np.array([0, 2]), np.array([[1, 2, 3], [3, 4, 5]]))
    assert seen.dtype == np.int64
    assert seen.tolist() == [[1, 3], [3, 5]]


def test_runs_that_see_differently_get_their_own() -> None:
    """Each run its own features, in whatever company."""
    excluded = (("x",), ("y", "z"), (), ("x",))
    sight = Sight([View(Representation(exclude=names), SPACE, FEATURES) for names in excluded])
    raw = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5]])
    expected = [[1, 2], [1], [2, 3, 4], [4, 5]]
    for runs in ([0, 1, 2, 3], [1], [0, 3], [2, 3]):
        seen = sight.start(np.array(runs), raw[runs])
        assert [row.tolist() for row in seen] == [expected[run] for run in runs]


@pytest.mark.parametrize("alike", [True, False])
def test_private_rewards_ends_and_stacks(alike: bool) -> None:
    """Where an episode ends for a learner alone the next state has no value, and what it sees begins anew."""
    mine = Representation(channel="v", stack=2, reward="bonus", terminal="over")
    other = mine if alike else Representation(channel="n")
    sight = Sight([View(mine, CHANNELS), View(other, CHANNELS)])
    runs = np.array([0, 1])
    sight.start(runs, entries((0, [0, 0], 0, 0), (0, [0, 0], 0, 0)))
    raw = entries((1, [1, 1], 5, 1), (1, [1, 1], 6, 0))
    told = sight.step(runs, raw, np.array([10.0, 20.0]), np.array([False, False]), np.array([True, True]))
    assert told.reward.tolist() == [5.0, 6.0 if alike else 20.0]
    assert told.terminated.tolist() == [True, False]
    assert told.truncated.tolist() == [False, True]
    assert told.next_observation[0].tolist() == [[0, 0], [1, 1]]
    assert told.coming[0].tolist() == [[1, 1], [1, 1]]
    assert np.asarray(told.coming[1]).tolist() == ([[0, 0], [1, 1]] if alike else 1)


def test_pushing_is_a_step_of_which_nothing_is_told() -> None:
    """What is seen next is what a whole step gives."""
    view = View(Representation(channel="v", stack=3, terminal="over"), CHANNELS)
    told, pushed = Sight([view]), Sight([view])
    run, no = np.array([0]), np.array([False])
    for sight in (told, pushed):
        sight.start(run, entries((0, [0, 0], 0, 0)))
    for step, over in enumerate((0, 0, 1, 0), 1):
        raw = entries((step, [step, step], 0, over))
        expected = told.step(run, raw, np.zeros(1), no, no).coming
        np.testing.assert_array_equal(pushed.push(run, raw), expected)


def test_views_are_alike_only_of_the_same() -> None:
    """Another representation, another space or other names of features make another view."""
    view = View(Representation(exclude=(0,)), SPACE, FEATURES)
    assert view.sees_like(View(Representation(exclude=(0,)), spaces.MultiDiscrete([4, 5, 6]), FEATURES))
    for other in (
        View(Representation(exclude=(1,)), SPACE, FEATURES),
        View(Representation(exclude=(0,)), spaces.MultiDiscrete([4, 5, 7]), FEATURES),
        View(Representation(exclude=(0,)), SPACE),
        WholeView(SPACE),
    ):
        assert not view.sees_like(other)
    assert WholeView(SPACE).sees_like(WholeView(SPACE))


def test_single_observations_are_seen_as_rows_are() -> None:
    """Bins, exclusion and channels of one observation are those of a batch of one."""
    bins = (Bins(0.0, 1.0, 3), Bins(0.0, 1.0, 5))
    view = View(Representation(bins=bins, exclude=(1,)), spaces.Box(0, 1, (2,)))
    assert (
        view(np.array([0.5, 0.9], dtype=np.float32)).tolist() == view.batch(np.array([[0.5, 0.9]]))[0].tolist() == [1]
    )
    row = entries((7, [1, 2], 0, 0))[0]
    assert int(View(Representation(channel="n"), CHANNELS)(row)) == 7
    assert View(Representation(channel="v"), CHANNELS)(row).tolist() == [1, 2]
