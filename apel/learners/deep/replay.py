"""Replay memories of many runs: rings of transitions (Lin 1992), drawn from uniformly or by priority."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.learners.base import State
from apel.learners.deep.encoding import FLOATS, Coding, encode
from apel.learners.deep.frames import Bytes, FramePool, Frames, add_step, frame, release
from apel.learners.deep.own import Own, draw_own, keep, own_of, own_part, rebuild
from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, integer


class Ring(NamedTuple):
    """The last N transitions of each of R runs."""

    frames: Frames
    numbers: NDArray[np.int64]
    """``[R, N, 2 · stack]``: of the frames of both observations."""
    action: NDArray[np.int32]
    """``[R, N]``, like the rest."""
    reward: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    added: NDArray[np.int64]
    """``[R]``: how many were ever added; the number of the next one."""
    own: Own


class Minibatch(NamedTuple):
    """B transitions of each of A runs, and room for what is computed of them."""

    slots: NDArray[np.int64]
    """``[A, B]``."""
    weight: NDArray[np.float32]
    """``[A, B]``: of importance."""
    inputs: NDArray[np.float32]
    """``[A, B, inputs]``."""
    next_inputs: NDArray[np.float32]
    action: NDArray[np.int64]
    reward: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    outputs: NDArray[np.float32]
    """``[A, B, outputs]``: of the network that learns."""
    next_outputs: NDArray[np.float32]
    gradient: NDArray[np.float32]
    """``[A, B, outputs]``: of the loss in ``outputs``."""

    @classmethod
    def empty(cls, num_runs: int, size: int, num_inputs: int, num_outputs: int) -> Minibatch:
        """Room for A = ``num_runs`` of B = ``size``."""
        grid = num_runs, size
        inputs, outputs = (*grid, num_inputs), (*grid, num_outputs)
        real = [np.zeros(shape, dtype=np.float32) for shape in (inputs, inputs, grid, outputs, outputs, outputs)]
        return cls(
            slots=np.zeros(grid, dtype=np.int64),
            weight=np.ones(grid, dtype=np.float32),
            inputs=real[0],
            next_inputs=real[1],
            action=np.zeros(grid, dtype=np.int64),
            reward=real[2],
            terminated=np.zeros(grid, dtype=np.bool_),
            outputs=real[3],
            next_outputs=real[4],
            gradient=real[5],
        )


@njit
def remember(
    ring: Ring,
    run: int,
    observation: Bytes,
    action: int,
    reward: float,
    next_observation: Bytes,
    terminated: bool,
    is_own: bool,
) -> int:
    """Store one transition of a run in place of its oldest; the slot that it went to."""
    capacity = ring.action.shape[1]
    slot = ring.added[run] % capacity
    add_step(ring.frames, run, observation, next_observation, ring.numbers[run, slot])
    ring.action[run, slot] = action
    ring.reward[run, slot] = reward
    ring.terminated[run, slot] = terminated
    oldest = max(ring.added[run] + 1 - capacity, 0)
    keep(ring.own, run, ring.added[run], oldest, is_own)
    ring.added[run] += 1
    first = ring.numbers[run, oldest % capacity, 0]
    for j in range(1, ring.numbers.shape[2]):
        first = min(first, ring.numbers[run, oldest % capacity, j])
    release(ring.frames, run, first)  # no later transition has an earlier frame
    return slot


@njit(inline="always")
def size_of(ring: Ring, run: int) -> int:
    """How many transitions a run holds."""
    return min(ring.added[run], ring.action.shape[1])


@njit
def draw(ring: Ring, run: int, stream: Stream, slots: NDArray[np.int64]) -> None:
    """Write slots ``[B]``, drawn uniformly, with replacement: the part that is to be own from what is own, the others
    from all.
    """
    part = own_part(ring.own, run, slots.shape[0])
    for j in range(part):
        slots[j] = draw_own(ring.own, run, stream) % ring.action.shape[1]
    for j in range(part, slots.shape[0]):
        slots[j] = integer(stream, size_of(ring, run))


@njit
def take(ring: Ring, coding: Coding, runs: Runs, batch: Minibatch) -> None:
    """Write the transitions in ``batch.slots``."""
    stack = ring.numbers.shape[2] // 2
    is_plain = stack == 1 and coding.kind == FLOATS
    for i in range(runs.shape[0]):
        run = runs[i]
        if is_plain:
            _take_numbers(ring, run, i, batch)
        for j in range(batch.slots.shape[1]):
            slot = batch.slots[i, j]
            if not is_plain:
                _encode_both(ring, coding, run, slot, batch.inputs[i, j], batch.next_inputs[i, j])
            batch.action[i, j] = ring.action[run, slot]
            batch.reward[i, j] = ring.reward[run, slot]
            batch.terminated[i, j] = ring.terminated[run, slot]


@njit
def _take_numbers(ring: Ring, run: int, i: int, batch: Minibatch) -> None:
    """Both observations of every transition where they go in as they are stored: the same, at a tenth of the time."""
    numbers = ring.frames.pool[run].view(np.float32)
    room, length = ring.frames.place.shape[1], numbers.shape[1]
    for j in range(batch.slots.shape[1]):
        slot = batch.slots[i, j]
        here = ring.frames.place[run, ring.numbers[run, slot, 0] % room]
        there = ring.frames.place[run, ring.numbers[run, slot, 1] % room]
        for k in range(length):
            batch.inputs[i, j, k] = numbers[here, k]
            batch.next_inputs[i, j, k] = numbers[there, k]


@njit
def _encode_both(ring: Ring, coding: Coding, run: int, slot: int, inputs: Any, next_inputs: Any) -> None:
    numbers = ring.numbers[run, slot]
    stack = numbers.shape[0] // 2
    _encode(ring.frames, coding, run, numbers[:stack], inputs)
    _encode(ring.frames, coding, run, numbers[stack:], next_inputs)


@njit(inline="always")
def _encode(frames: Frames, coding: Coding, run: int, numbers: NDArray[np.int64], inputs: Any) -> None:
    length = inputs.shape[0] // numbers.shape[0]
    for k in range(numbers.shape[0]):
        one = frame(frames, run, numbers[k])
        encode(coding, one.reshape((1, one.shape[0])), inputs[k * length : (k + 1) * length])


def check_room(filled: int, added: int, capacity: int) -> None:
    """See that what stood in a ring stands in the same slots of this one: none is full, or it is as large.

    Parameters
    ----------
    filled, added:
        How many slots of that ring are filled, and how often one was.
    capacity:
        Slots of this one.

    Raises
    ------
    ValueError
        If it does not.
    """
    if filled > capacity or (added > filled and filled != capacity):
        message = (
            f"found room for {capacity} in the replay memory, expected {filled}, as in the one that it begins with"
        )
        raise ValueError(message)


class ReplayMemory:
    """The rings of R runs.

    Observations are not stored twice, and no frame of a stack is: 10 000 transitions of stacks of four 84 × 84 frames
    take 72 MB, 10⁶ take 7.2 GB, where each by itself would take 564 MB and 56 GB.

    Parameters
    ----------
    num_runs, capacity:
        R, and how many transitions are remembered.
    stack, frame_bytes:
        How many frames an observation has, and bytes of each.
    """

    def __init__(self, num_runs: int, capacity: int, stack: int, frame_bytes: int) -> None:
        # One more frame for each episode that ends in memory, and those of the step that is being added.
        self._frames = FramePool(num_runs, capacity + max(capacity // 16, 4 * stack), stack, frame_bytes)
        # Zeros take up memory only once they are written to.
        grid = num_runs, capacity
        self._columns: tuple[NDArray[Any], ...] = (
            np.zeros((*grid, 2 * stack), dtype=np.int64),
            np.zeros(grid, dtype=np.int32),
            np.zeros(grid, dtype=np.float32),
            np.zeros(grid, dtype=np.bool_),
        )
        self._added = np.zeros(num_runs, dtype=np.int64)
        self._own = own_of(num_runs, 0, 0)

    @property
    def arrays(self) -> Ring:
        """As compiled code works on them."""
        numbers, action, reward, terminated = self._columns
        return Ring(self._frames.arrays, numbers, action, reward, terminated, self._added, self._own)

    def keep_own(self, part: int) -> None:
        """From now on note who played, and draw so many of each minibatch from what is own; `arrays` are replaced."""
        self._own = own_of(len(self._added), self._columns[1].shape[1], part)

    @property
    def size(self) -> NDArray[np.int64]:
        """``int64[R]``: how many each run holds."""
        return np.minimum(self._added, self._columns[1].shape[1])

    def reserve(self, runs: Runs, steps: int) -> bool:
        """See to room for so many steps of each of ``runs``; whether `arrays` had to be replaced."""
        return self._frames.reserve(runs, min(steps, self._columns[1].shape[1] + 1))

    def state(self) -> State:
        """All that is filled."""
        filled = int(self.size.max(initial=0))
        columns = [column[:, :filled].copy() for column in self._columns]
        own = {"own": self._own.is_own[:, :filled].copy()} if self._own.part else {}
        return {"added": self._added.copy(), "columns": columns, "frames": self._frames.state(), **own}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned; `arrays` may have to be replaced.

        Raises
        ------
        ValueError
            If that is of a memory of another size, and does not fit.
        """
        check_room(state["columns"][1].shape[1], int(np.max(state["added"])), self._columns[1].shape[1])
        self._added[:] = state["added"]
        for column, stored in zip(self._columns, state["columns"], strict=True):
            column[:, : stored.shape[1]] = stored
        self._frames.restore(state["frames"])
        rebuild(self._own, state.get("own"), self._added - self.size, self._added)
