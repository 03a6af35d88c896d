"""What the recorded episodes say of the runs of an arm: areas, steps to a criterion, which learner returned what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from jobs.analysis.statistics.bootstrap import Floats
from jobs.experiment.spec import Experiment
from jobs.results.episodes import read_episodes
from jobs.results.storage import Folder

_COLUMNS = ("run_index", "episode", "selected", "return", "length")


@dataclass
class PlayedRuns:
    """Of the runs of an arm at a sweep point, by run index.

    Attributes
    ----------
    area:
        Mean return over the run: over its environment steps where they end it, else over its episodes.
    steps_to_criterion:
        Environment steps until the criterion was met; known where every episode was recorded.
    late_return:
        Mean return of each learner's recorded episodes of the last tenth, ``float64[learners]``; NaN without one.
    late_episodes:
        How many these are, ``int64[learners]``.
    num_recorded, num_played:
        Episodes, over all runs.
    """

    area: dict[int, float] = field(default_factory=dict)
    steps_to_criterion: dict[int, float] = field(default_factory=dict)
    late_return: dict[int, Floats] = field(default_factory=dict)
    late_episodes: dict[int, NDArray[np.int64]] = field(default_factory=dict)
    num_recorded: int = 0
    num_played: int = 0


@dataclass(frozen=True)
class _Run:
    """Recorded episodes of a run, in order, ``[episodes]`` each."""

    episode: NDArray[np.int64]
    selected: NDArray[np.int64]
    episode_return: Floats
    length: Floats
    num_episodes: int

    @property
    def is_whole(self) -> bool:
        """Whether every episode is recorded."""
        return len(self.episode) == self.num_episodes


def played_runs(
    folder: Folder, experiment: Experiment, arm: str, sweep: str, rows: Mapping[int, Mapping[str, float]], count: int
) -> PlayedRuns:
    """Read the recorded episodes of an arm at a sweep point.

    Parameters
    ----------
    folder, arm, sweep:
        Where they lie.
    experiment:
        As it is at that sweep point.
    rows:
        Run rows by run index: ``episodes``, ``train_time`` (NaN without one).
    count:
        Learners of the arm.

    Raises
    ------
    StoreError
        If a file of episodes is damaged.
    """
    found = PlayedRuns()
    table = read_episodes(folder, arm, _COLUMNS, sweep)
    if table is None or not len(table):
        return found
    for index, run in _runs(table, rows):
        found.num_recorded += len(run.episode)
        found.num_played += run.num_episodes
        found.area[index] = _area(run, by_steps=experiment.steps is not None)
        train_time = rows[index].get("train_time", np.nan)
        if run.is_whole and np.isfinite(train_time):
            found.steps_to_criterion[index] = float(run.length[: int(train_time)].sum())
        found.late_return[index], found.late_episodes[index] = _by_learner(run, _is_late(run, experiment), count)
    return found


def _runs(table: pa.Table, rows: Mapping[int, Mapping[str, float]]) -> Iterator[tuple[int, _Run]]:
    columns = [table[name].to_numpy() for name in _COLUMNS]
    order = np.lexsort((columns[1], columns[0]))
    index, episode, selected, episode_return, length = (column[order] for column in columns)
    found, first = np.unique(index, return_index=True)
    for run, begin, end in zip(found.tolist(), first, [*first[1:], len(index)], strict=True):
        if run in rows:
            part = slice(begin, end)
            num_episodes = int(rows[run]["episodes"])
            values = episode[part], selected[part], episode_return[part], length[part].astype(np.float64)
            yield run, _Run(*values, num_episodes)


def _area(run: _Run, *, by_steps: bool) -> float:
    """Mean return; an episode stands for those around it that are nearer to it than to any other that was recorded."""
    between = (run.episode[1:] + run.episode[:-1] + 1) / 2
    weight = np.diff(np.concatenate(([0.0], between, [float(run.num_episodes)])))
    if by_steps:
        weight = weight * run.length
    return float(weight @ run.episode_return / weight.sum())


def _is_late(run: _Run, experiment: Experiment) -> NDArray[np.bool_]:
    """Which episodes are of the last tenth, as `cluster.last_tenth` has it; by episodes where steps are unknown."""
    ends = np.cumsum(run.length)
    if experiment.steps and run.is_whole and ends[-1] >= experiment.steps:
        return ends > experiment.steps - -(-experiment.steps // 10)
    return run.episode >= run.num_episodes - -(-run.num_episodes // 10)


def _by_learner(run: _Run, is_late: NDArray[np.bool_], count: int) -> tuple[Floats, NDArray[np.int64]]:
    is_late = is_late & (run.selected >= 0) & (run.selected < count)
    selected = run.selected[is_late]
    number = np.bincount(selected, minlength=count)
    total = np.bincount(selected, weights=run.episode_return[is_late], minlength=count)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan), number
