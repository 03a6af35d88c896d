"""Frames that are stored once, however many stacks of observations they are part of.

A step's observation is mostly the last step's next one, and a stack differs from the one before in a single frame.
Which frames are the same is told by their bytes, so that nothing depends on who hands them over, or in which order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.batched import Runs
from apel.compiled import njit
from apel.learners.base import State

_Bytes = NDArray[np.uint8]
_GROWTH = 1.5
_END, _FIRST, _USED, _FREE = range(4)


class FramePool:
    """The frames of R runs, each numbered in the order in which it came.

    Parameters
    ----------
    num_runs, room:
        R, and for how many frames of each there is room at first; it grows where that is too few.
    stack:
        How many frames an observation has.
    shape:
        Of an observation, ``[stack, …]``, or of its only frame where ``stack`` is 1.
    frame_type:
        Of its elements.
    """

    def __init__(self, num_runs: int, room: int, stack: int, shape: Sequence[int], frame_type: np.dtype[Any]) -> None:
        self._stack, self._shape, self._type = stack, tuple(shape[1:] if stack > 1 else shape), frame_type
        self._num_bytes = int(np.prod(self._shape, dtype=np.int64)) * frame_type.itemsize
        # Zeros take up memory only once they are written to, and places are used again before new ones are.
        self._bytes = np.zeros((num_runs, room, self._num_bytes), dtype=np.uint8)
        self._place = np.zeros((num_runs, room), dtype=np.int32)
        self._free = np.zeros((num_runs, room), dtype=np.int32)
        # Of each run: the next number, the smallest that is held, places ever used, and places free among them.
        self._counts = np.zeros((num_runs, 4), dtype=np.int64)
        self._last = np.full((num_runs, stack), -1, dtype=np.int64)

    @property
    def num_frames(self) -> NDArray[np.int64]:
        """``int64[R]``: how many frames each run holds."""
        return self._counts[:, _END] - self._counts[:, _FIRST]

    def add(self, runs: Runs, observation: NDArray[Any], following: NDArray[Any]) -> NDArray[np.int64]:
        """The numbers ``int64[A, 2 · stack]`` of the frames of one step of each of ``runs``: of its observation, and of
        the next one. Frames that are where they are expected keep the numbers that they have; the others get new ones.
        """
        most = 2 * self._stack
        if (self.num_frames[runs] + most > self._bytes.shape[1]).any():
            self._grow(most)
        numbers = np.empty((len(runs), most), dtype=np.int64)
        storage = self._bytes, self._place, self._free, self._counts, self._last
        _add(runs, self._flat(observation), self._flat(following), *storage, numbers)
        return numbers

    def release(self, runs: Runs, first: NDArray[np.int64]) -> None:
        """Forget the frames of each of ``runs`` with numbers below ``first`` ``[A]``."""
        _release(runs, first, self._place, self._free, self._counts)

    def take(self, runs: Runs, numbers: NDArray[np.int64]) -> NDArray[Any]:
        """The frames ``[A, …, *shape]`` of each run with these numbers ``[A, …]``."""
        run = runs.reshape(-1, *(1,) * (numbers.ndim - 1))
        place = self._place[run, numbers % self._place.shape[1]]
        return self._bytes[run, place].view(self._type).reshape(*numbers.shape, *self._shape)

    def state(self) -> State:
        """All frames that are held, in order."""
        every = np.arange(len(self._counts))
        held = np.arange(self.num_frames.max(initial=0)) + self._counts[:, [_FIRST]]
        frames = self._bytes[every[:, None], self._place[every[:, None], held % self._place.shape[1]]]
        frames[held >= self._counts[:, [_END]]] = 0
        return {"numbers": self._counts[:, [_END, _FIRST]].copy(), "last": self._last.copy(), "frames": frames}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        frames = np.array(state["frames"])
        self._counts[:, [_END, _FIRST]] = state["numbers"]
        self._last = np.array(state["last"])
        count = frames.shape[1]
        if count > self._bytes.shape[1]:
            self._resize(count)
        self._bytes[:, :count] = frames
        self._counts[:, _USED], self._counts[:, _FREE] = self.num_frames, 0
        places = np.arange(count, dtype=np.int32)
        for run, first in enumerate(self._counts[:, _FIRST]):
            self._place[run, (first + places) % self._place.shape[1]] = places

    def _flat(self, observation: NDArray[Any]) -> _Bytes:
        values = np.ascontiguousarray(observation, dtype=self._type)
        return values.reshape(-1).view(np.uint8).reshape(len(values), self._stack, self._num_bytes)

    def _grow(self, most: int) -> None:
        state = self.state()
        self._resize(max(int(self._bytes.shape[1] * _GROWTH), int(self.num_frames.max()) + most))
        self.restore(state)

    def _resize(self, room: int) -> None:
        num_runs = len(self._counts)
        self._bytes = np.zeros((num_runs, room, self._num_bytes), dtype=np.uint8)
        self._place = np.zeros((num_runs, room), dtype=np.int32)
        self._free = np.zeros((num_runs, room), dtype=np.int32)


@njit
def _equal(one: _Bytes, other: _Bytes) -> bool:
    for i in range(one.shape[0]):  # noqa: SIM110 - compiled code knows no generators
        if one[i] != other[i]:
            return False
    return True


@njit
def _add(
    runs: Runs,
    observation: _Bytes,
    following: _Bytes,
    pool: _Bytes,
    place: NDArray[np.int32],
    free: NDArray[np.int32],
    counts: NDArray[np.int64],
    last: NDArray[np.int64],
    numbers: NDArray[np.int64],
) -> None:
    """See `FramePool.add`; ``numbers`` is written, the arrays before it are updated."""
    stack = observation.shape[1]
    for i in range(runs.shape[0]):
        run = runs[i]
        for j in range(stack):
            known = last[run, j]
            is_known = known >= counts[run, _FIRST] and _equal(
                pool[run, place[run, known % place.shape[1]]], observation[i, j]
            )
            numbers[i, j] = known if is_known else _store(run, observation[i, j], pool, place, free, counts)
        for j in range(stack):
            # A stack's frames are those of the stack before, moved on by one; the newest is new.
            if j + 1 < stack and _equal(observation[i, j + 1], following[i, j]):
                number = numbers[i, j + 1]
            else:
                number = _store(run, following[i, j], pool, place, free, counts)
            numbers[i, stack + j] = last[run, j] = number


@njit
def _store(
    run: int,
    frame: _Bytes,
    pool: _Bytes,
    place: NDArray[np.int32],
    free: NDArray[np.int32],
    counts: NDArray[np.int64],
) -> int:
    """Give a frame the next number of its run."""
    if counts[run, _FREE] > 0:
        counts[run, _FREE] -= 1
        where = free[run, counts[run, _FREE]]
    else:
        where = counts[run, _USED]
        counts[run, _USED] += 1
    pool[run, where] = frame
    number = counts[run, _END]
    place[run, number % place.shape[1]] = where
    counts[run, _END] += 1
    return number


@njit
def _release(
    runs: Runs,
    first: NDArray[np.int64],
    place: NDArray[np.int32],
    free: NDArray[np.int32],
    counts: NDArray[np.int64],
) -> None:
    for i in range(runs.shape[0]):
        run = runs[i]
        while counts[run, _FIRST] < first[i]:
            free[run, counts[run, _FREE]] = place[run, counts[run, _FIRST] % place.shape[1]]
            counts[run, _FREE] += 1
            counts[run, _FIRST] += 1
