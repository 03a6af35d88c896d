"""Memory of segments of trajectories, for many runs: what ACER replays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.batched import Runs
from apel.learners.base import State
from apel.learners.deep.draws import Streams, draw_indices
from apel.learners.stacked import Transitions


class Segments(NamedTuple):
    """B segments of at most T steps for each of A runs."""

    observation: NDArray[Any]
    """``[A, B, T + 1, …]``: the state after the last step included."""
    action: NDArray[np.int64]
    """``[A, B, T]``."""
    reward: NDArray[np.float32]
    behaviour: NDArray[np.float32]
    """``[A, B, T, actions]``: μ(·|s), NaN where not known."""
    length: NDArray[np.int64]
    """``[A, B]``."""
    terminated: NDArray[np.bool_]
    """``[A, B]``: the episode was over after the last step."""


class SegmentMemory:
    """The last ``capacity`` closed segments of each of R runs, and the one that each is in.

    A segment is closed after ``length`` steps, or where its episode ends. The open one stands in the slot that comes
    next.

    Attributes
    ----------
    num_closed:
        ``int64[R]``: how many segments each run has closed so far.
    """

    def __init__(
        self,
        num_runs: int,
        capacity: int,
        length: int,
        num_actions: int,
        shape: Sequence[int],
        storage_type: np.dtype[Any],
    ) -> None:
        self._slots, self._length = capacity + 1, length
        self.num_closed = np.zeros(num_runs, dtype=np.int64)
        rooms = (num_runs, self._slots, length)
        self._observation = np.zeros((num_runs, self._slots, length + 1, *shape), dtype=storage_type)
        self._action = np.zeros(rooms, dtype=np.int16)
        self._reward = np.zeros(rooms, dtype=np.float32)
        self._behaviour = np.zeros((*rooms, num_actions), dtype=np.float32)
        self._steps = np.zeros((num_runs, self._slots), dtype=np.int64)
        self._terminated = np.zeros((num_runs, self._slots), dtype=np.bool_)

    @property
    def size(self) -> NDArray[np.int64]:
        """``int64[R]``: how many closed segments each run remembers."""
        return np.minimum(self.num_closed, self._slots - 1)

    def add(self, runs: Runs, transitions: Transitions) -> Runs:
        """Append one step to the open segment of each run; the runs whose segment it closed."""
        slots = self.num_closed[runs] % self._slots
        step = self._steps[runs, slots]
        self._observation[runs, slots, step] = transitions.observation
        self._observation[runs, slots, step + 1] = transitions.next_observation
        self._action[runs, slots, step] = transitions.action
        self._reward[runs, slots, step] = transitions.reward
        self._behaviour[runs, slots, step] = transitions.probability
        self._terminated[runs, slots] = transitions.terminated
        self._steps[runs, slots] = step + 1
        is_closed = (step + 1 == self._length) | transitions.terminated | transitions.truncated
        closed = runs[is_closed]
        self.num_closed[closed] += 1
        self._steps[closed, self.num_closed[closed] % self._slots] = 0
        return closed

    def newest(self, runs: Runs) -> Segments:
        """The segment that each run closed last."""
        return self._take(runs, (self.num_closed[runs] - 1)[:, None])

    def draw(self, runs: Runs, batch_size: int, streams: Streams) -> Segments:
        """Segments drawn uniformly, with replacement, from the closed ones."""
        ages = draw_indices(self.size, runs, batch_size, streams)
        return self._take(runs, self.num_closed[runs][:, None] - 1 - ages)

    def state(self) -> State:
        """All that is filled, the open segments included."""
        filled = min(int(self.num_closed.max(initial=0)) + 1, self._slots)
        return {"closed": self.num_closed.copy(), "columns": [column[:, :filled].copy() for column in self._columns()]}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self.num_closed = np.array(state["closed"])
        for column, stored in zip(self._columns(), state["columns"], strict=True):
            column[:, : stored.shape[1]] = stored

    def _take(self, runs: Runs, numbers: NDArray[np.int64]) -> Segments:
        chosen = runs[:, None], numbers % self._slots
        return Segments(
            observation=self._observation[chosen],
            action=self._action[chosen].astype(np.int64),
            reward=self._reward[chosen],
            behaviour=self._behaviour[chosen],
            length=self._steps[chosen],
            terminated=self._terminated[chosen],
        )

    def _columns(self) -> list[NDArray[Any]]:
        return [self._observation, self._action, self._reward, self._behaviour, self._steps, self._terminated]
