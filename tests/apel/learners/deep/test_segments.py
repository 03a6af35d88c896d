"""Memory of segments of trajectories: where they are closed, which are drawn, and what stands in them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from cluster.checkpoint import pack, unpack
from tests.apel.learners.deep.memories import SegmentsTaken, SegmentStore, sampling_streams
from tests.apel.learners.deep.steps import runs_of, transitions


def memory_of(capacity: int = 3, length: int = 4, num_runs: int = 2) -> SegmentStore:
    return SegmentStore(num_runs, capacity, length)


def play(memory: SegmentStore, run: int, first: int, steps: int, *, end: str = "") -> list[int]:
    """``steps`` steps numbered from ``first``, n → n + 1 with action n mod 2, reward n / 4, μ = (n / 1000, …).

    The last one terminates or truncates the episode if ``end`` says so. Returns the numbers of the steps that closed a
    segment.
    """
    closing = []
    for n in range(first, first + steps):
        is_last = n == first + steps - 1
        step = transitions(
            [[n]],
            [[n + 1]],
            action=n % 2,
            reward=n / 4,
            terminated=is_last and end == "terminated",
            truncated=is_last and end == "truncated",
            probability=[[n / 1000, 1 - n / 1000]],
        )
        if len(memory.add(runs_of(run), step)):
            closing.append(n)
    return closing


def content(segments: SegmentsTaken, run: int = 0, place: int = 0) -> tuple[list[float], list[float], bool]:
    """States and rewards of the steps that are there, and whether the episode was over."""
    length = int(segments.length[run, place])
    states = segments.observation[run, place, : length + 1, 0].tolist()
    return states, segments.reward[run, place, :length].tolist(), bool(segments.terminated[run, place])


def test_segments_are_closed_by_length() -> None:
    """After ``length`` steps; the state after the last one belongs to it, and begins the next."""
    memory = memory_of()
    assert play(memory, 1, 0, 9) == [3, 7]
    assert memory.size.tolist() == [0, 2]
    newest = memory.newest(runs_of(1))
    assert content(newest) == ([4.0, 5.0, 6.0, 7.0, 8.0], [1.0, 1.25, 1.5, 1.75], False)
    assert newest.action.tolist() == [[[0, 1, 0, 1]]]
    expected = np.array([[n / 1000, 1 - n / 1000] for n in range(4, 8)], dtype=np.float32)
    np.testing.assert_array_equal(newest.behaviour[0, 0], expected)


@pytest.mark.parametrize(("end", "terminated"), [("terminated", True), ("truncated", False)])
def test_segments_are_closed_by_the_end_of_the_episode(end: str, terminated: bool) -> None:
    """An episode's end closes a segment short of its length; only where it terminated is the value after it zero."""
    memory = memory_of()
    assert play(memory, 0, 10, 6, end=end) == [13, 15]
    assert content(memory.newest(runs_of(0))) == ([14.0, 15.0, 16.0], [3.5, 3.75], terminated)
    assert play(memory, 0, 20, 4, end=end) == [23]
    assert content(memory.newest(runs_of(0))) == ([20.0, 21.0, 22.0, 23.0, 24.0], [5.0, 5.25, 5.5, 5.75], terminated)
    assert play(memory, 0, 30, 4) == [33]
    assert not memory.newest(runs_of(0)).terminated[0, 0]


def test_unknown_behaviour_is_kept_as_such() -> None:
    """A step whose μ is not known has NaN, and those beside it their own."""
    memory = memory_of(length=2)
    memory.add(runs_of(0), transitions([[0]], [[1]], num_actions=2))
    memory.add(runs_of(0), transitions([[1]], [[2]], probability=[[0.25, 0.75]]))
    behaviour = memory.newest(runs_of(0)).behaviour[0, 0]
    assert np.isnan(behaviour[0]).all()
    assert behaviour[1].tolist() == [0.25, 0.75]


def test_only_those_are_named_whose_segment_was_closed() -> None:
    """Of several runs in one call."""
    memory = memory_of(num_runs=3)
    play(memory, 0, 0, 3)
    play(memory, 2, 0, 1)
    step = transitions([[7]] * 3, [[8]] * 3, truncated=[False, False, True], num_actions=2)
    assert memory.add(runs_of(0, 1, 2), step).tolist() == [0, 2]
    assert memory.size.tolist() == [1, 0, 1]


def draw(memory: SegmentStore, run: int, count: int, seed: int = 1) -> SegmentsTaken:
    return memory.draw(runs_of(run), count, sampling_streams([seed] * 2))


def test_draws_are_uniform_over_closed_segments() -> None:
    """The last 3 of 5, each as often (chi-square with p > 0.001): neither the open one nor those overwritten."""
    memory = memory_of()
    play(memory, 0, 0, 22)
    drawn = draw(memory, 0, 6000)
    first = drawn.observation[0, :, 0, 0].astype(int)
    assert set(first.tolist()) == {8, 12, 16}
    assert stats.chisquare(np.bincount(first)[[8, 12, 16]]).pvalue > 0.001
    for place in range(20):
        start = float(first[place])
        assert content(drawn, place=place)[0] == [start + i for i in range(5)]


@settings(max_examples=60)
@given(
    capacity=st.integers(1, 4),
    length=st.integers(1, 4),
    episodes=st.lists(st.tuples(st.integers(1, 6), st.sampled_from(["", "terminated", "truncated"])), max_size=15),
)
def test_memory_is_the_plain_list(capacity: int, length: int, episodes: list[tuple[int, str]]) -> None:
    """Whatever is played: the last ``capacity`` closed segments are drawn, whole, and the newest is their last."""
    memory = SegmentStore(1, capacity, length)
    closed: list[tuple[list[float], list[float], bool]] = []
    states: list[float] = []
    n = 0
    for steps, end in episodes:
        play(memory, 0, n, steps, end=end)
        for i in range(n, n + steps):
            states.append(float(i))
            is_over = bool(end) and i == n + steps - 1
            if len(states) == length or is_over:
                rewards = [state / 4 for state in states]
                closed.append(([*states, i + 1.0], rewards, is_over and end == "terminated"))
                states = []
        n += steps
        kept = closed[-capacity:]
        assert memory.size.tolist() == [len(kept)]
        if kept:
            assert content(memory.newest(runs_of(0))) == kept[-1]
            drawn = draw(memory, 0, 40)
            found = [content(drawn, place=i) for i in range(40)]
            assert all(one in kept for one in found)
            assert len(kept) > 1 or found[0] == kept[0]


@pytest.mark.parametrize("steps", [0, 3, 5, 18, 29])
def test_restored_memory_goes_on_identically(steps: int) -> None:
    """A state that went through a file holds the open segment too; other contents of the new memory do not matter."""
    memory, other = memory_of(), memory_of()
    play(memory, 0, 0, steps)
    play(memory, 1, 100, 2)
    play(other, 0, 500, 23)
    play(other, 1, 600, 3)
    other.restore(unpack(pack(memory.state())))
    for first in (1000, 2000):
        for one in (memory, other):
            play(one, 0, first, 7, end="truncated")
            play(one, 1, first, 1)
        assert memory.size.tolist() == other.size.tolist()
        assert same(memory.newest(runs_of(0)), other.newest(runs_of(0)))
        assert same(draw(memory, 0, 9), draw(other, 0, 9))


def same(one: SegmentsTaken, other: SegmentsTaken) -> bool:
    """Equal in all steps that are there."""
    places = np.ndindex(*one.length.shape)
    there = np.arange(one.action.shape[-1]) < one.length[..., None]
    alike: list[Any] = [content(one, *place) == content(other, *place) for place in places]
    alike += [np.array_equal(one.length, other.length), np.array_equal(one.action[there], other.action[there])]
    return all(alike) and np.array_equal(one.behaviour[there], other.behaviour[there])


def test_state_is_a_snapshot() -> None:
    """What is played later does not change a state."""
    memory = memory_of()
    play(memory, 0, 0, 5)
    state = memory.state()
    before = [column.copy() for column in state["columns"]]
    play(memory, 0, 50, 30)
    assert all(np.array_equal(one, same) for one, same in zip(state["columns"], before, strict=True))
    assert state["closed"].tolist() == [1, 0]
