"""Frames that are stored once, however many stacks of observations they are part of.

A step's observation is mostly the last step's next one, and a stack differs from the one before in a single frame.
Which frames are the same is told by their bytes, so that nothing depends on who hands them over, or in which order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.learners.base import State
from apel.numerics.compiled import njit

Bytes = NDArray[np.uint8]
_GROWTH = 1.5
_END, _FIRST, _USED, _FREE = range(4)


class Frames(NamedTuple):
    """Those of R runs, each numbered in the order in which it came."""

    pool: Bytes
    """``uint8[R, room, bytes]``."""
    place: NDArray[np.int32]
    """``[R, room]``: where the frame with a number stands, by that number modulo the room."""
    free: NDArray[np.int32]
    """``[R, room]``: places to be used again."""
    counts: NDArray[np.int64]
    """``[R, 4]``: the next number, the smallest that is held, places ever used, and places free among them."""
    last: NDArray[np.int64]
    """``[R, stack]``: the numbers of the newest observation."""


@njit
def _equal(one: Bytes, other: Bytes) -> bool:
    for i in range(one.shape[0]):  # noqa: SIM110 - compiled code knows no generators
        if one[i] != other[i]:
            return False
    return True


@njit
def frame(frames: Frames, run: int, number: int) -> Bytes:
    """The bytes of the frame with this number."""
    return frames.pool[run, frames.place[run, number % frames.place.shape[1]]]


@njit
def add_step(frames: Frames, run: int, observation: Bytes, next_observation: Bytes, numbers: NDArray[np.int64]) -> None:
    """Write the ``numbers`` ``[2 · stack]`` of the frames of one step: of its observation, and of the next one, both
    ``[stack, bytes]``. Frames that are where they are expected keep the numbers that they have; the others get new
    ones.
    """
    stack = observation.shape[0]
    for j in range(stack):
        known = frames.last[run, j]
        is_known = known >= frames.counts[run, _FIRST] and _equal(frame(frames, run, known), observation[j])
        numbers[j] = known if is_known else _store(frames, run, observation[j])
    for j in range(stack):
        # A stack's frames are those of the stack before, moved on by one; the newest is new.
        if j + 1 < stack and _equal(observation[j + 1], next_observation[j]):
            numbers[stack + j] = numbers[j + 1]
        else:
            numbers[stack + j] = _store(frames, run, next_observation[j])
        frames.last[run, j] = numbers[stack + j]


@njit
def _store(frames: Frames, run: int, one: Bytes) -> int:
    """Give a frame the next number of its run."""
    counts = frames.counts[run]
    if counts[_FREE] > 0:
        counts[_FREE] -= 1
        where = np.int64(frames.free[run, counts[_FREE]])
    else:
        where = counts[_USED]
        counts[_USED] += 1
    frames.pool[run, where] = one
    number = counts[_END]
    frames.place[run, number % frames.place.shape[1]] = where
    counts[_END] += 1
    return number


@njit
def release(frames: Frames, run: int, first: int) -> None:
    """Forget the frames with numbers below ``first``."""
    counts = frames.counts[run]
    while counts[_FIRST] < first:
        frames.free[run, counts[_FREE]] = frames.place[run, counts[_FIRST] % frames.place.shape[1]]
        counts[_FREE] += 1
        counts[_FIRST] += 1


class FramePool:
    """The frames of R runs, in room that grows where it is too small.

    Parameters
    ----------
    num_runs, room:
        R, and for how many frames of each there is room at first.
    stack, frame_bytes:
        How many frames an observation has, and bytes of each.
    """

    def __init__(self, num_runs: int, room: int, stack: int, frame_bytes: int) -> None:
        counts, last = np.zeros((num_runs, 4), dtype=np.int64), np.full((num_runs, stack), -1, dtype=np.int64)
        self.arrays = Frames(*_room(num_runs, room, frame_bytes), counts, last)

    @property
    def num_frames(self) -> NDArray[np.int64]:
        """``int64[R]``: how many frames each run holds."""
        return self.arrays.counts[:, _END] - self.arrays.counts[:, _FIRST]

    def reserve(self, runs: Runs, steps: int) -> bool:
        """See to room for so many steps of each of ``runs``; whether `arrays` had to be replaced."""
        counts = self.arrays.counts
        held = (counts[runs, _END] - counts[runs, _FIRST]).max()
        most = int(held) + 2 * self.arrays.last.shape[1] * steps
        if most <= self.arrays.pool.shape[1]:
            return False
        state = self.state()
        self._resize(max(int(self.arrays.pool.shape[1] * _GROWTH), most))
        self.restore(state)
        return True

    def state(self) -> State:
        """All frames that are held, in order."""
        arrays = self.arrays
        every = np.arange(len(arrays.counts))
        held = np.arange(self.num_frames.max(initial=0)) + arrays.counts[:, [_FIRST]]
        frames = arrays.pool[every[:, None], arrays.place[every[:, None], held % arrays.place.shape[1]]]
        frames[held >= arrays.counts[:, [_END]]] = 0
        return {"numbers": arrays.counts[:, [_END, _FIRST]].copy(), "last": arrays.last.copy(), "frames": frames}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        frames = np.array(state["frames"])
        count = frames.shape[1]
        if count > self.arrays.pool.shape[1]:
            self._resize(count)
        arrays = self.arrays
        arrays.counts[:, [_END, _FIRST]] = state["numbers"]
        arrays.last[:] = state["last"]
        arrays.pool[:, :count] = frames
        arrays.counts[:, _USED], arrays.counts[:, _FREE] = self.num_frames, 0
        places = np.arange(count, dtype=np.int32)
        for run, first in enumerate(arrays.counts[:, _FIRST]):
            arrays.place[run, (first + places) % arrays.place.shape[1]] = places

    def _resize(self, room: int) -> None:
        num_runs, _, frame_bytes = self.arrays.pool.shape
        self.arrays = Frames(*_room(num_runs, room, frame_bytes), *self.arrays[3:])


def _room(num_runs: int, room: int, frame_bytes: int) -> tuple[Bytes, NDArray[np.int32], NDArray[np.int32]]:
    # Zeros take up memory only once they are written to, and places are used again before new ones are.
    place, free = np.zeros((2, num_runs, room), dtype=np.int32)
    return np.zeros((num_runs, room, frame_bytes), dtype=np.uint8), place, free
