"""The memories of several runs, asked for as a test would ask: calls name runs, and arrays come back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.learners.banks.batched_learner import Transitions
from apel.learners.base import State
from apel.learners.deep.deep_learner import Steps
from apel.learners.deep.draws import Streams
from apel.learners.deep.encoding import Encoder
from apel.learners.deep.frames import frame
from apel.learners.deep.prioritised import Priorities, PriorityOptions, draw_by_priority, reconsider, welcome
from apel.learners.deep.replay import Minibatch, ReplayMemory, draw, remember, take
from apel.learners.deep.segments import SegmentBatch, SegmentMemory, append, draw_segments, take_newest


def acting_streams(seeds: Sequence[int]) -> NDArray[np.uint64]:
    """Of actions."""
    return Streams.of_seeds(seeds).acting


def sampling_streams(seeds: Sequence[int]) -> NDArray[np.uint64]:
    """Of minibatches."""
    return Streams.of_seeds(seeds).sampling


def steps_of(encoder: Encoder, transitions: Transitions, *, own: bool = False) -> Steps:
    """Transitions as memories take them, all of them the learner's own or none."""
    seen, following = (encoder.stored(one) for one in (transitions.observation, transitions.next_observation))
    played = np.full(len(seen), own)
    return Steps(seen, transitions.action, transitions.reward, following, *transitions[4:], played)


class Taken(NamedTuple):
    """Transitions, ``[A, B, …]``."""

    observation: NDArray[Any]
    action: NDArray[np.int64]
    reward: NDArray[np.float32]
    next_observation: NDArray[Any]
    terminated: NDArray[np.bool_]


class Ring:
    """A replay memory of observations of one space."""

    def __init__(self, num_runs: int, capacity: int, space: spaces.Space[Any]) -> None:
        self.encoder = Encoder(space)
        self.memory = ReplayMemory(num_runs, capacity, self.encoder.stack, self.encoder.frame_bytes)
        self._space, self._capacity = space, capacity

    @property
    def size(self) -> NDArray[np.int64]:
        """Of each run."""
        return self.memory.size

    def add(self, runs: Runs, transitions: Transitions, *, own: bool = False) -> NDArray[np.int64]:
        """The slots that they went to."""
        self.memory.reserve(runs, 1)
        steps, slots = steps_of(self.encoder, transitions, own=own), []
        for i, run in enumerate(runs.tolist()):
            row = steps.frames[i], steps.action[i], steps.reward[i], steps.next_frames[i], steps.terminated[i], own
            slots.append(remember(self.memory.arrays, run, *row))
        return np.array(slots)

    def draw(self, runs: Runs, size: int, streams: NDArray[np.uint64]) -> NDArray[np.int64]:
        """Slots."""
        slots = np.zeros((len(runs), size), dtype=np.int64)
        for i, run in enumerate(runs.tolist()):
            draw(self.memory.arrays, run, streams[run], slots[i])
        return slots

    def take(self, runs: Runs, slots: NDArray[np.int64]) -> Taken:
        """What is in these slots, and is encoded as it should be."""
        count = int(np.prod(self.encoder.shape))
        batch = Minibatch.empty(len(runs), slots.shape[1], count, 1)._replace(slots=slots)
        take(self.memory.arrays, self.encoder.coding, runs, batch)
        seen, following = (self._frames(runs, slots, part) for part in (0, 1))
        for inputs, observations in ((batch.inputs, seen), (batch.next_inputs, following)):
            flat = observations.reshape(-1, *observations.shape[2:])
            np.testing.assert_array_equal(inputs.reshape(-1, count), self.encoder(flat).reshape(-1, count))
        return Taken(seen, batch.action, batch.reward, following, batch.terminated)

    def state(self) -> State:
        """A checkpoint's."""
        return self.memory.state()

    def restore(self, state: State) -> None:
        """Go back to it."""
        self.memory.restore(state)

    def _frames(self, runs: Runs, slots: NDArray[np.int64], part: int) -> NDArray[Any]:
        ring, stack = self.memory.arrays, self.encoder.stack
        kind = np.uint8 if self._space.dtype == np.uint8 else np.float32
        shape = *slots.shape, *(self._space.shape or ())
        rows = [
            [frame(ring.frames, run, number) for number in ring.numbers[run, slot, part * stack : (part + 1) * stack]]
            for i, run in enumerate(runs.tolist())
            for slot in slots[i]
        ]
        return np.array(rows, dtype=np.uint8).view(kind).reshape(shape)


class PriorityTrees:
    """Priorities."""

    def __init__(self, num_runs: int, capacity: int, options: PriorityOptions) -> None:
        self.priorities = Priorities(num_runs, capacity, options)

    def add(self, runs: Runs, slots: NDArray[np.int64], *, own: bool = False) -> None:
        """One new transition of each run."""
        for run, slot in zip(runs.tolist(), slots.tolist(), strict=True):
            welcome(self.priorities.arrays, run, slot, own)

    def draw(
        self,
        runs: Runs,
        size: NDArray[np.int64],
        batch_size: int,
        correction: NDArray[Any],
        streams: NDArray[Any],
        *,
        part: int = 0,
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """With β = ``correction``, and so many of what is own."""
        slots = np.zeros((len(runs), batch_size), dtype=np.int64)
        weights = np.zeros((len(runs), batch_size), dtype=np.float32)
        for i, run in enumerate(runs.tolist()):
            trees = self.priorities.arrays._replace(correction=float(correction[i]))
            draw_by_priority(trees, run, int(size[run]), 0.0, part, streams[run], slots[i], weights[i])
        return slots, weights

    def update(self, runs: Runs, slots: NDArray[np.int64], errors: NDArray[Any]) -> None:
        """After an update."""
        for i, run in enumerate(runs.tolist()):
            reconsider(self.priorities.arrays, run, slots[i], errors[i])

    def state(self) -> Any:
        """A checkpoint's."""
        return self.priorities.state()

    def restore(self, state: Any, is_own: NDArray[np.bool_] | None = None) -> None:
        """Go back to it."""
        nothing = np.zeros((len(self.priorities.arrays.sums), 0), dtype=np.bool_)
        self.priorities.restore(state, nothing if is_own is None else is_own)


class SegmentsTaken(NamedTuple):
    """Segments, filled up to the longest: ``[A, B, T, …]``."""

    observation: NDArray[Any]
    action: NDArray[np.int64]
    reward: NDArray[np.float32]
    behaviour: NDArray[np.float32]
    length: NDArray[np.int64]
    terminated: NDArray[np.bool_]


class SegmentStore:
    """A memory of segments of single numbers with two actions."""

    def __init__(self, num_runs: int, capacity: int, length: int) -> None:
        self.encoder = Encoder(spaces.Box(-np.inf, np.inf, (1,)))
        self.memory = SegmentMemory(num_runs, capacity, length, 2, (1, self.encoder.frame_bytes))
        self._length = length

    @property
    def size(self) -> NDArray[np.int64]:
        """Closed ones that are remembered."""
        return np.minimum(self.memory.arrays.closed, self.memory.arrays.length.shape[1] - 1)

    def add(self, runs: Runs, transitions: Transitions, *, own: bool = False) -> Runs:
        """The runs whose segment it closed."""
        steps = steps_of(self.encoder, transitions, own=own)
        closed = [append(self.memory.arrays, run, steps, i) for i, run in enumerate(runs.tolist())]
        return runs[np.array(closed, dtype=np.bool_)]

    def newest(self, runs: Runs, streams: NDArray[np.uint64] | None = None) -> SegmentsTaken:
        """Closed last; by ``streams`` an own one is drawn, where one is wanted."""
        batch = SegmentBatch.empty(len(runs), 1, self._length, 1, 2)
        drawn = np.zeros((len(self.size), 2), dtype=np.uint64) if streams is None else streams
        take_newest(self.memory.arrays, self.encoder.coding, runs, drawn, batch)
        return self._taken(batch)

    def draw(self, runs: Runs, size: int, streams: NDArray[np.uint64]) -> SegmentsTaken:
        """Drawn from all."""
        batch = SegmentBatch.empty(len(runs), size, self._length, 1, 2)
        draw_segments(self.memory.arrays, self.encoder.coding, runs, size, streams, batch)
        return self._taken(batch)

    def state(self) -> State:
        """A checkpoint's."""
        return self.memory.state()

    def restore(self, state: State) -> None:
        """Go back to it."""
        self.memory.restore(state)

    def _taken(self, batch: SegmentBatch) -> SegmentsTaken:
        length = np.diff(batch.begin, axis=1) - 1
        grid = (*length.shape, self._length)
        found = SegmentsTaken(
            np.zeros((*length.shape, self._length + 1, 1)), np.zeros(grid, dtype=np.int64),
            np.zeros(grid, dtype=np.float32), np.zeros((*grid, 2), dtype=np.float32), length, batch.terminated,
        )  # fmt: skip
        for i, j in np.ndindex(*length.shape):
            begin, count = batch.begin[i, j], length[i, j]
            found.observation[i, j, : count + 1] = batch.inputs[i, begin : begin + count + 1]
            for name in ("action", "reward", "behaviour"):
                getattr(found, name)[i, j, :count] = getattr(batch, name)[i, begin : begin + count]
        return found
