"""Replay memories of many runs: rings of transitions (Lin 1992), drawn from uniformly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.batched import Runs
from apel.learners.base import State
from apel.learners.deep.draws import Streams, draw_indices
from apel.learners.deep.frames import FramePool
from apel.learners.stacked import Transitions


class Minibatch(NamedTuple):
    """B transitions of each of A runs."""

    observation: NDArray[Any]
    """``[A, B, …]``, as stored."""
    action: NDArray[np.int64]
    reward: NDArray[np.float32]
    next_observation: NDArray[Any]
    terminated: NDArray[np.float32]
    """1 where the episode was over, 0 elsewhere."""


class Replay:
    """The last ``capacity`` transitions of each of R runs.

    Observations are not stored twice, and no frame of a stack is: 10 000 transitions of stacks of four 84 × 84 frames
    take 72 MB, 10⁶ take 7.2 GB, where each by itself would take 564 MB and 56 GB.

    Parameters
    ----------
    num_runs, capacity:
        R, and how many transitions are remembered.
    shape, storage_type:
        Of an observation.
    stack:
        How many frames an observation has, along its first axis.

    Attributes
    ----------
    size:
        ``int64[R]``: how many each run holds.
    """

    def __init__(
        self, num_runs: int, capacity: int, shape: Sequence[int], storage_type: np.dtype[Any], stack: int = 1
    ) -> None:
        self._capacity, self._stack, self._shape = capacity, stack, tuple(shape)
        self.size = np.zeros(num_runs, dtype=np.int64)
        self._added = np.zeros(num_runs, dtype=np.int64)
        # One more frame for each episode that ends in memory, and those of the step that is being added.
        room = capacity + max(capacity // 16, 4 * stack)
        self._frames = FramePool(num_runs, room, stack, shape, storage_type)
        # Zeros take up memory only once they are written to.
        self._numbers = np.zeros((num_runs, capacity, 2 * stack), dtype=np.int64)
        self._action = np.zeros((num_runs, capacity), dtype=np.int16)
        self._reward = np.zeros((num_runs, capacity), dtype=np.float32)
        self._terminated = np.zeros((num_runs, capacity), dtype=np.bool_)

    def add(self, runs: Runs, transitions: Transitions) -> NDArray[np.int64]:
        """Store one transition of each run in place of its oldest; the slots that they went to."""
        slots = self._added[runs] % self._capacity
        self._numbers[runs, slots] = self._frames.add(runs, transitions.observation, transitions.next_observation)
        self._action[runs, slots] = transitions.action
        self._reward[runs, slots] = transitions.reward
        self._terminated[runs, slots] = transitions.terminated
        self._added[runs] += 1
        self.size[runs] = np.minimum(self._added[runs], self._capacity)
        oldest = np.maximum(self._added[runs] - self._capacity, 0) % self._capacity
        # No later transition has an earlier frame.
        self._frames.release(runs, self._numbers[runs, oldest].min(axis=1))
        return slots

    def draw(self, runs: Runs, batch_size: int, streams: Streams) -> NDArray[np.int64]:
        """Slots ``int64[A, B]``, uniformly with replacement."""
        return draw_indices(self.size, runs, batch_size, streams)

    def take(self, runs: Runs, slots: NDArray[np.int64]) -> Minibatch:
        """The transitions in ``slots`` ``[A, B]``."""
        chosen = runs[:, None], slots
        frames = self._frames.take(runs, self._numbers[chosen])
        shape = *slots.shape, *self._shape
        return Minibatch(
            observation=frames[:, :, : self._stack].reshape(shape),
            action=self._action[chosen].astype(np.int64),
            reward=self._reward[chosen],
            next_observation=frames[:, :, self._stack :].reshape(shape),
            terminated=self._terminated[chosen].astype(np.float32),
        )

    def state(self) -> State:
        """All that is filled."""
        return {
            "added": self._added.copy(),
            "columns": [column[:, : self._filled()].copy() for column in self._columns()],
            "frames": self._frames.state(),
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._added = np.array(state["added"])
        self.size = np.minimum(self._added, self._capacity)
        for column, stored in zip(self._columns(), state["columns"], strict=True):
            column[:, : self._filled()] = stored
        self._frames.restore(state["frames"])

    def _filled(self) -> int:
        return int(self.size.max(initial=0))

    def _columns(self) -> list[NDArray[Any]]:
        return [self._numbers, self._action, self._reward, self._terminated]
