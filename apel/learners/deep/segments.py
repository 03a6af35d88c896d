"""Memory of segments of trajectories, for many runs: what ACER replays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.learners.base import State
from apel.learners.deep.encoding import Coding, encode
from apel.learners.deep.own import Own, draw_own, keep, own_of, own_part, rebuild
from apel.learners.deep.replay import check_room
from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, integer


class Segments(NamedTuple):
    """The last N closed segments of each of R runs, of at most T steps, and the one that each is in.

    A segment is closed after T steps, or where its episode ends. The open one stands in the slot that comes next, so
    that there are N + 1 slots.
    """

    frames: NDArray[np.uint8]
    """``[R, N + 1, T + 1, stack, bytes]``: the state after the last step included."""
    action: NDArray[np.int32]
    """``[R, N + 1, T]``."""
    reward: NDArray[np.float32]
    behaviour: NDArray[np.float32]
    """``[R, N + 1, T, actions]``: μ(·|s), NaN where not known."""
    length: NDArray[np.int64]
    """``[R, N + 1]``."""
    terminated: NDArray[np.bool_]
    """``[R, N + 1]``: the episode was over after the last step."""
    closed: NDArray[np.int64]
    """``[R]``: how many each run has closed so far; the number of the open one."""
    own: Own


class SegmentBatch(NamedTuple):
    """Some segments of each of A runs, one after the other, and room for what is computed of them.

    A segment of n steps takes up n + 1 rows: the last is of the state after it, in which nothing was done.
    """

    begin: NDArray[np.int64]
    """``[A, B + 1]``: where each begins, and the last one ends."""
    terminated: NDArray[np.bool_]
    """``[A, B]``."""
    inputs: NDArray[np.float32]
    """``[A, rows, inputs]``."""
    action: NDArray[np.int64]
    """``[A, rows]``."""
    reward: NDArray[np.float32]
    behaviour: NDArray[np.float32]
    """``[A, rows, actions]``."""
    outputs: NDArray[np.float32]
    """``[A, rows, 2 · actions]``: logits and Q of the network that learns."""
    average: NDArray[np.float32]
    """The same of the average network."""
    gradient: NDArray[np.float32]
    """``[A, rows, 2 · actions]``: of the loss in ``outputs``."""

    @classmethod
    def empty(cls, num_runs: int, size: int, length: int, num_inputs: int, num_actions: int) -> SegmentBatch:
        """Room for A = ``num_runs`` of B = ``size`` segments of ``length`` steps."""
        rows = num_runs, size * (length + 1)
        inputs, outputs = (*rows, num_inputs), (*rows, 2 * num_actions)
        shapes = inputs, rows, (*rows, num_actions), outputs, outputs, outputs
        real = [np.zeros(shape, dtype=np.float32) for shape in shapes]
        return cls(
            begin=np.zeros((num_runs, size + 1), dtype=np.int64),
            terminated=np.zeros((num_runs, size), dtype=np.bool_),
            inputs=real[0],
            action=np.zeros(rows, dtype=np.int64),
            reward=real[1],
            behaviour=real[2],
            outputs=real[3],
            average=real[4],
            gradient=real[5],
        )


@njit
def append(memory: Segments, run: int, steps: Any, i: int) -> bool:
    """Append step ``i`` of `Steps` to the open segment; whether that closed it."""
    slots = memory.length.shape[1]
    slot = memory.closed[run] % slots
    step = memory.length[run, slot]
    memory.frames[run, slot, step] = steps.frames[i]
    memory.frames[run, slot, step + 1] = steps.next_frames[i]
    memory.action[run, slot, step] = steps.action[i]
    memory.reward[run, slot, step] = steps.reward[i]
    for a in range(memory.behaviour.shape[3]):
        memory.behaviour[run, slot, step, a] = steps.probability[i, a]
    memory.terminated[run, slot] = steps.terminated[i]
    memory.length[run, slot] = step + 1
    if step + 1 < memory.action.shape[2] and not steps.terminated[i] and not steps.truncated[i]:
        return False
    keep(memory.own, run, memory.closed[run], memory.closed[run] + 2 - slots, steps.own[i])
    memory.closed[run] += 1
    memory.length[run, memory.closed[run] % slots] = 0
    return True


@njit
def take_newest(memory: Segments, coding: Coding, runs: Runs, streams: NDArray[np.uint64], batch: SegmentBatch) -> int:
    """Write the segment that each run closed last; the rows of the longest.

    Where a part is to be own it is a minibatch of one, which is own: in place of another's stands one that is drawn.
    """
    longest = 0
    for i in range(runs.shape[0]):
        run = runs[i]
        number = memory.closed[run] - 1
        if own_part(memory.own, run, 1) > 0 and not memory.own.is_own[run, number % memory.length.shape[1]]:
            number = draw_own(memory.own, run, streams[run])
        longest = max(longest, _take(memory, coding, run, number, batch, i, 0))
    return longest


@njit
def draw_segments(
    memory: Segments, coding: Coding, runs: Runs, size: int, streams: NDArray[np.uint64], batch: SegmentBatch
) -> int:
    """Write ``size`` segments of each run, drawn uniformly, with replacement, from the closed ones, the part that is
    to be own from what is own; the rows of the run that has most.
    """
    longest = 0
    for i in range(runs.shape[0]):
        run = runs[i]
        stream: Stream = streams[run]
        part = own_part(memory.own, run, size)
        for j in range(part):
            longest = max(longest, _take(memory, coding, run, draw_own(memory.own, run, stream), batch, i, j))
        for j in range(part, size):
            age = integer(stream, min(memory.closed[run], memory.length.shape[1] - 1))
            longest = max(longest, _take(memory, coding, run, memory.closed[run] - 1 - age, batch, i, j))
    return longest


@njit
def _take(memory: Segments, coding: Coding, run: int, number: int, batch: SegmentBatch, i: int, j: int) -> int:
    """Write a segment as number ``j`` of a batch; where it ends."""
    slot = number % memory.length.shape[1]
    length, begin = memory.length[run, slot], batch.begin[i, j]
    for step in range(length + 1):
        encode(coding, memory.frames[run, slot, step], batch.inputs[i, begin + step])
    for step in range(length):
        batch.action[i, begin + step] = memory.action[run, slot, step]
        batch.reward[i, begin + step] = memory.reward[run, slot, step]
        batch.behaviour[i, begin + step] = memory.behaviour[run, slot, step]
    batch.terminated[i, j] = memory.terminated[run, slot]
    end = begin + length + 1
    batch.begin[i, j + 1] = end
    return end


class SegmentMemory:
    """The segments of R runs.

    Parameters
    ----------
    num_runs, capacity, length:
        R, how many closed segments are remembered, and steps of each.
    num_actions:
        How many actions there are.
    frames:
        Frames of an observation, and bytes of each.
    """

    def __init__(self, num_runs: int, capacity: int, length: int, num_actions: int, frames: tuple[int, int]) -> None:
        slots = num_runs, capacity + 1
        grid = *slots, length
        self.arrays = Segments(
            frames=np.zeros((*slots, length + 1, *frames), dtype=np.uint8),
            action=np.zeros(grid, dtype=np.int32),
            reward=np.zeros(grid, dtype=np.float32),
            behaviour=np.zeros((*grid, num_actions), dtype=np.float32),
            length=np.zeros(slots, dtype=np.int64),
            terminated=np.zeros(slots, dtype=np.bool_),
            closed=np.zeros(num_runs, dtype=np.int64),
            own=own_of(num_runs, 0, 0),
        )

    def keep_own(self, part: int) -> None:
        """From now on note who played, and draw so many of each minibatch from what is own; `arrays` are replaced."""
        self.arrays = self.arrays._replace(own=own_of(len(self.arrays.length), self.arrays.length.shape[1], part))

    def state(self) -> State:
        """All that is filled, the open segments included."""
        closed, own = self.arrays.closed, self.arrays.own
        filled = min(int(closed.max(initial=0)) + 1, self.arrays.length.shape[1])
        told = {"own": own.is_own[:, :filled].copy()} if own.part else {}
        return {"closed": closed.copy(), "columns": [column[:, :filled].copy() for column in self._columns], **told}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned.

        Raises
        ------
        ValueError
            If that is of a memory of another size, and does not fit.
        """
        closed, capacity = self.arrays.closed, self.arrays.length.shape[1] - 1  # an open segment has a slot of its own
        check_room(state["columns"][0].shape[1] - 1, int(np.max(state["closed"])), capacity)
        closed[:] = state["closed"]
        for column, stored in zip(self._columns, state["columns"], strict=True):
            column[:, : stored.shape[1]] = stored
        held = np.minimum(closed, capacity)
        rebuild(self.arrays.own, state.get("own"), closed - held, closed)

    @property
    def _columns(self) -> list[NDArray[Any]]:
        """Those with a row for each slot."""
        held = self.arrays
        return [held.frames, held.action, held.reward, held.behaviour, held.length, held.terminated]
