"""Frames that are stored once: what comes back is what went in, in as little memory as there are different frames."""

from __future__ import annotations

from collections import deque
from typing import cast

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from apel.experience.frame_stacking import stacked_space
from apel.learners.banks.batched_learner import Transitions
from apel.learners.deep.frames import FramePool, add_step, frame, release
from cluster.checkpoint import pack, unpack
from tests.apel.learners.deep.memories import Ring
from tests.apel.learners.deep.steps import runs_of, transitions


def frames(stack: int, *shape: int) -> spaces.Box:
    """Stacks of frames of bytes; one by one where there are no stacks."""
    single = spaces.Box(0, 1, shape, np.uint8)
    return single if stack == 1 else cast("spaces.Box", stacked_space(single, stack))


def floats(*shape: int) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, shape)


def stacks(lengths: list[int], stack: int, seed: int) -> list[Transitions]:
    """The steps of episodes of such lengths, observations ``[1, stack, 2, 3]``; the last step of each is its end.

    Frames have few values, so that equal ones come up by chance too.
    """
    generator = np.random.default_rng(seed)
    steps = []
    for length in lengths:
        recent: deque[NDArray[np.uint8]] = deque([generator.integers(0, 2, (2, 3), dtype=np.uint8)] * stack, stack)
        for t in range(length):
            before = np.stack(recent)
            recent.append(generator.integers(0, 2, (2, 3), dtype=np.uint8))
            steps.append(transitions([before], [np.stack(recent)], action=t % 3, terminated=t + 1 == length))
    return steps


def contents(memory: Ring, run: int) -> list[tuple[bytes, bytes]]:
    """Both observations of every transition, by slot."""
    batch = memory.take(runs_of(run), np.arange(memory.size[run])[None])
    pairs = zip(batch.observation[0], batch.next_observation[0], strict=True)
    return [(one.tobytes(), other.tobytes()) for one, other in pairs]


@settings(max_examples=40, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 9), min_size=1, max_size=12),
    stack=st.integers(1, 4),
    capacity=st.integers(1, 12),
    seed=st.integers(0, 9),
    restored=st.integers(0, 60),
)
def test_memory_is_a_ring_of_plain_transitions(
    lengths: list[int], stack: int, capacity: int, seed: int, restored: int
) -> None:
    """Against a list that keeps whole observations, two runs side by side, through a checkpoint on the way."""
    memory = Ring(2, capacity, frames(stack, 2, 3))
    naive: list[list[tuple[bytes, bytes]]] = [[b""] * capacity for _ in range(2)]  # type: ignore[list-item]
    for n, step in enumerate(stacks(lengths, stack, seed)):
        if n == restored:
            state = unpack(pack(memory.state()))
            memory = Ring(2, capacity, frames(stack, 2, 3))
            memory.restore(state)
        run = 1 if n % 3 == 2 and n > 5 else 0  # the other run comes in later, and sees gaps
        slot = int(memory.add(runs_of(run), step)[0])
        naive[run][slot] = (step.observation[0].tobytes(), step.next_observation[0].tobytes())
        assert contents(memory, run) == naive[run][: memory.size[run]]
    assert contents(memory, 0) == naive[0][: memory.size[0]]


def test_every_frame_is_held_once() -> None:
    """Three episodes of 10 steps have 33 frames in stacks of 4; the last 12 transitions need the 10 steps of the last
    episode, 2 of the one before, and the frames of their stacks.
    """
    pool_of = {}
    for capacity in (100, 12):
        memory = Ring(1, capacity, frames(4, 50, 50))
        generator = np.random.default_rng(1)
        for _ in range(3):
            first = generator.integers(0, 256, (50, 50), dtype=np.uint8)
            recent = deque([first] * 4, 4)
            for _ in range(10):
                before = np.stack(recent)
                recent.append(generator.integers(0, 256, (50, 50), dtype=np.uint8))
                memory.add(runs_of(0), transitions([before], [np.stack(recent)]))
        pool_of[capacity] = int(memory.memory._frames.num_frames[0])
    # The first frame of an episode comes four times at once, and is stored as often.
    assert pool_of == {100: 3 * (4 + 10), 12: (4 + 10) + (4 + 2)}


def test_what_does_not_move_on_by_one_comes_back_all_the_same() -> None:
    """Observations of any kind: nothing is taken for granted of what a learner is handed."""
    generator = np.random.default_rng(2)
    memory = Ring(1, 5, frames(3, 4))
    steps = [generator.integers(0, 2, (2, 1, 3, 4), dtype=np.uint8) for _ in range(40)]
    for one, other in steps:
        memory.add(runs_of(0), transitions(one, other))
        slot = (memory.memory._added[0] - 1) % 5
        assert contents(memory, 0)[slot] == (one.tobytes(), other.tobytes())
    assert set(contents(memory, 0)) == {(one.tobytes(), other.tobytes()) for one, other in steps[-5:]}


def test_room_grows_where_every_step_is_an_episode() -> None:
    """Two new observations per transition: more than there is room for at first."""
    memory = Ring(2, 64, floats(3))
    for n in range(100):
        memory.add(runs_of(0, 1), transitions([[n, n, n]] * 2, [[n + 0.5, n, n]] * 2))
    batch = memory.take(runs_of(0, 1), np.tile(np.arange(64), (2, 1)))
    assert sorted(batch.observation[1, :, 0].tolist()) == list(range(36, 100))
    assert sorted(batch.next_observation[0, :, 0].tolist()) == [n + 0.5 for n in range(36, 100)]
    assert memory.memory._frames.num_frames.tolist() == [128, 128]


def test_not_a_number_comes_back() -> None:
    """Frames are compared by their bytes, so that NaN, and zeros of both signs, are what they were."""
    memory = Ring(1, 8, floats(2))
    for value in (np.nan, -0.0, 0.0, np.nan):
        memory.add(runs_of(0), transitions([[value, 1.0]], [[value, 2.0]]))
    batch = memory.take(runs_of(0), np.arange(4)[None])
    expected = np.array([[np.nan, 1.0], [-0.0, 1.0], [0.0, 1.0], [np.nan, 1.0]], dtype=np.float32)
    assert batch.observation[0].tobytes() == expected.tobytes()


@pytest.mark.parametrize("stack", [1, 2])
def test_pool_numbers_go_on(stack: int) -> None:
    """Numbers rise by one with every new frame; what is known keeps its number."""
    pool = FramePool(1, 50, stack, 2)
    shown = [np.full((stack, 2), value, dtype=np.uint8) for value in range(3)]

    def add(one: int, other: int) -> list[int]:
        numbers = np.zeros(2 * stack, dtype=np.int64)
        add_step(pool.arrays, 0, shown[one], shown[other], numbers)
        return numbers.tolist()

    assert add(0, 1) == list(range(2 * stack))
    assert add(1, 2) == list(range(stack, 3 * stack))
    release(pool.arrays, 0, stack)
    assert pool.num_frames.tolist() == [2 * stack]
    third = add(2, 0)
    assert third == [*range(2 * stack, 3 * stack), *range(3 * stack, 4 * stack)]
    assert [frame(pool.arrays, 0, number).tolist() for number in third[:stack]] == shown[2].tolist()
