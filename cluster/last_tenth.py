"""The mean return of the last tenth of a run: how well it does in the end, whatever else is asked of it."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from apel.experience.trajectory import Episodes
from apel.run.state import ANY_STEPS, Book


class LastTenth(NamedTuple):
    """Sums and numbers of the returns of R runs, ``[R]`` each, written in place.

    The last tenth of a run that its cap of N episodes ends are its last ⌈N / 10⌉ episodes; of one that its cap of S
    steps ends, the episodes that end after more than S − ⌈S / 10⌉ steps. Which it is to be is known at its end alone.
    """

    first_episode: NDArray[np.int64]
    """From which on the last tenth of the episodes is; the same for all runs."""
    first_step: NDArray[np.int64]
    episode_sum: NDArray[np.float64]
    episode_count: NDArray[np.int64]
    step_sum: NDArray[np.float64]
    step_count: NDArray[np.int64]

    @classmethod
    def of(cls, book: Book) -> Self:
        """Before the first episode."""
        count = len(book.episode)
        first_step = book.num_steps - -(-book.num_steps // 10) if book.num_steps != ANY_STEPS else ANY_STEPS
        return cls(
            np.full(count, book.num_episodes - -(-book.num_episodes // 10)),
            np.full(count, first_step),
            np.zeros(count),
            np.zeros(count, dtype=np.int64),
            np.zeros(count),
            np.zeros(count, dtype=np.int64),
        )

    def take_in(self, episodes: Episodes, steps: NDArray[np.int64]) -> None:
        """Take in episodes that follow on ``steps``, ``int64[R]``: those that every run had made before them."""
        run = episodes.run
        if not len(run):
            return
        late = episodes.episode >= self.first_episode[run]
        # One after the other, so that a sum does not depend on how many episodes came at once.
        np.add.at(self.episode_sum, run[late], episodes.episode_return[late])
        np.add.at(self.episode_count, run[late], 1)
        if self.first_step[0] == ANY_STEPS:
            return
        late = _ends(run, episodes.length, steps) > self.first_step[run]
        np.add.at(self.step_sum, run[late], episodes.episode_return[late])
        np.add.at(self.step_count, run[late], 1)

    def mean(self, book: Book) -> NDArray[np.float64]:
        """``float64[R]``; NaN for a run that has not come to either of its caps."""
        by_steps, by_episodes = book.steps >= book.num_steps, book.episode == book.num_episodes
        total = np.where(by_steps, self.step_sum, self.episode_sum)
        count = np.where(by_steps, self.step_count, np.where(by_episodes, self.episode_count, 0))
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _ends(run: NDArray[np.int64], length: NDArray[np.int64], steps: NDArray[np.int64]) -> NDArray[np.int64]:
    """The steps that each run has made at the end of each of these episodes.

    >>> _ends(np.array([1, 0, 1]), np.array([3, 4, 5]), np.array([10, 20])).tolist()
    [23, 14, 28]
    """
    order = np.argsort(run, kind="stable")
    total = np.cumsum(length[order])
    first = np.searchsorted(run[order], run[order], side="left")
    before = total[first] - length[order][first]
    ends = np.empty_like(total)
    ends[order] = total - before + steps[run[order]]
    return ends
