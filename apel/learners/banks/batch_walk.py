"""Walking through the episodes of a batch, one step of every run at a time."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.experience.action_form import ActionForm
from apel.experience.trajectory import TrajectoryBatch


class WalkedStep(NamedTuple):
    """One step of A runs, in rising order; see `apel.experience.action_form` for actions and μ."""

    next_entry: NDArray[Any]
    action: NDArray[Any]
    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    probability: NDArray[np.float64]


class BatchWalk:
    """A place in the episodes of each run of a batch.

    Attributes
    ----------
    runs:
        ``int64[A]``: the runs that have steps left, in rising order.
    """

    def __init__(self, batch: TrajectoryBatch, form: ActionForm) -> None:
        self._batch, self._form = batch, form
        length = batch.episodes.length
        self._first_step = np.cumsum(length) - length
        # Rows of the batch run by run, each run's in the order of play, and where each run's begin and end.
        self._row = np.argsort(batch.episodes.run, kind="stable")
        self.runs, begin, count = np.unique(batch.episodes.run[self._row], return_index=True, return_counts=True)
        self._at, self._end = begin.astype(np.int64), begin + count
        self._taken = np.zeros(len(self.runs), dtype=np.int64)

    @property
    def episodes(self) -> NDArray[np.int64]:
        """``int64[A]``: which episode each run is in."""
        return self._batch.episodes.episode[self._row[self._at]]

    @property
    def entries(self) -> NDArray[Any]:
        """``[A, …]``: the entries at which every run stands."""
        row = self._row[self._at]
        # Every episode before has one more observation than steps.
        return self._batch.observation[self._first_step[row] + self._taken + row]

    def step(self, going: NDArray[np.int64]) -> WalkedStep:
        """The step from where those of `runs` stand that are at the positions ``going``."""
        batch, row = self._batch, self._row[self._at[going]]
        here = self._first_step[row] + self._taken[going]
        is_last = self._taken[going] + 1 == batch.episodes.length[row]
        terminated = is_last & batch.episodes.terminated[row]
        return WalkedStep(
            next_entry=batch.observation[here + row + 1],
            action=self._form.counted(batch.action[here]),
            reward=batch.reward_value[batch.reward_code[here]],
            terminated=terminated,
            truncated=is_last & ~terminated,
            probability=self._form.unknown(len(row)) if batch.probability is None else batch.probability[here],
        )

    def advance(self, going: NDArray[np.int64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Go on to the next step of those, and forget runs that have none: which of the runs before begin an episode
        now, and which of them are left.
        """
        started = np.zeros(len(self.runs), dtype=np.bool_)
        self._taken[going] += 1
        started[going] = self._taken[going] == self._batch.episodes.length[self._row[self._at[going]]]
        self._at[started] += 1
        self._taken[started] = 0
        left = self._at < self._end
        self.keep(left)
        return started, left

    def keep(self, kept: NDArray[np.bool_]) -> None:
        """Forget the other runs."""
        if not kept.all():
            self.runs, self._at, self._end, self._taken = (
                column[kept] for column in (self.runs, self._at, self._end, self._taken)
            )
