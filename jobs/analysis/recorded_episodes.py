"""Recorded episodes side by side, run by run: over episodes, and over the environment steps that they took."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import pyarrow as pa
from numpy.lib.stride_tricks import sliding_window_view

from jobs.analysis.statistics.bootstrap import Floats
from jobs.results.episodes import read_episodes
from jobs.results.storage import Folder


class IncompleteError(ValueError):
    """Of some runs only a part of the episodes is recorded, so nobody knows at which step an episode ended."""


class Curves:
    """Recorded episodes of an arm at a sweep point: ``float64[runs, episodes(, learners)]`` by quantity.

    Attributes
    ----------
    run_index:
        ``int64[runs]``, rising.
    episodes:
        ``int64[episodes]``, rising: those that any run has.
    """

    def __init__(self, table: pa.Table) -> None:
        self.run_index, row = np.unique(table["run_index"].to_numpy(), return_inverse=True)
        self.episodes, column = np.unique(table["episode"].to_numpy(), return_inverse=True)
        self.num_runs = len(self.run_index)
        self._place = (row, column)
        self._table = table

    def values(self, quantity: str) -> Floats:
        """NaN where a run has ended, or where nothing is known."""
        chunks = self._table[quantity].combine_chunks()
        shape: tuple[int, ...] = (self.num_runs, len(self.episodes))
        numbers = chunks
        if pa.types.is_list(chunks.type):
            numbers = chunks.flatten()
            shape = (*shape, len(numbers) // len(chunks))
        found = np.full(shape, np.nan)
        rows = numbers.to_numpy(zero_copy_only=False).astype(np.float64)
        found[self._place] = rows.reshape(-1, *shape[2:])
        return found

    @property
    def has_ended_runs(self) -> bool:
        """Whether some runs ended before others."""
        return len(self._place[0]) < self.num_runs * len(self.episodes)

    @cached_property
    def ends(self) -> Floats:
        """``float64[runs, episodes]``: environment steps of the run at the end of each episode; NaN after its last.

        Raises
        ------
        IncompleteError
            If a run has episodes that were not recorded.
        """
        lengths = self.values("length")
        num_recorded = np.isfinite(lengths).sum(axis=1)
        if len(self.episodes) != self.episodes[-1] + 1 or np.isnan(lengths[:, 0]).any():
            is_whole = np.zeros(self.num_runs, dtype=np.bool_)
        else:
            last = lengths.shape[1] - 1 - np.argmax(np.isfinite(lengths)[:, ::-1], axis=1)
            is_whole = num_recorded == last + 1
        if not is_whole.all():
            message = (
                f"found {int((~is_whole).sum())} of {self.num_runs} runs with episodes that were not recorded, "
                "expected record: all, by which alone the environment steps are known"
            )
            raise IncompleteError(message)
        return np.cumsum(lengths, axis=1)

    @property
    def num_steps(self) -> Floats:
        """``float64[runs]``: environment steps of each run."""
        return np.nanmax(self.ends, axis=1)


def read_curves(folder: Folder, arm: str, sweep: str, columns: Sequence[str]) -> Curves | None:
    """Recorded episodes of an arm at a sweep point, with only these columns; None where there are none."""
    table = read_episodes(folder, arm, ["run_index", "episode", *columns], sweep)
    return Curves(table) if table is not None and len(table) else None


def moving_mean(values: Floats, width: int) -> Floats:
    """Mean of each run's last ``width`` values; of fewer at its beginning.

    Every window is added up by itself, so that equal ones have equal means, whatever came before them.
    """
    if width == 1:
        return values
    known = np.nan_to_num(values)
    total = np.cumsum(known, axis=1)
    if width <= values.shape[1]:
        total[:, width - 1 :] = sliding_window_view(known, width, axis=1).sum(axis=-1)
    number = np.cumsum(np.isfinite(values), axis=1)
    number[:, width:] -= number[:, :-width].copy()
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(np.isfinite(values), total / number, np.nan)


def at_steps(values: Floats, ends: Floats, steps: Floats) -> Floats:
    """What each run had come to by each step: the value of the last episode that ended at or before it.

    Parameters
    ----------
    values, ends:
        ``float64[runs, episodes]``; environment steps at the end of each episode, see `Curves.ends`.
    steps:
        ``float64[points]``, rising.

    Returns
    -------
    ``float64[runs, points]``; NaN before a run's first episode has ended, and after its last one has.
    """
    found = np.full((len(values), len(steps)), np.nan)
    for run, known in enumerate(np.isfinite(ends).sum(axis=1)):
        place = np.searchsorted(ends[run, :known], steps, side="right") - 1
        inside = (place >= 0) & (steps <= ends[run, known - 1])
        found[run, inside] = values[run, place[inside]]
    return found
