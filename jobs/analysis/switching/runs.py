"""From recorded episodes to switch delays: one row per run of every ensemble; see `jobs.analysis.switching.delay`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jobs.analysis.recorded_episodes import Curves, at_steps, moving_mean, read_curves
from jobs.analysis.statistics.bootstrap import Floats
from jobs.analysis.switching.delay import crossover_step, switch_delay
from jobs.experiment.figures import SwitchRoles
from jobs.results.storage import Folder

Point = tuple[str, str]
"""Arm and sweep point."""

_GRID = 400


class SwitchData:
    """What is recorded of the two learners alone, and of the ensembles that hold both.

    Attributes
    ----------
    ensembles:
        Arms and sweep points that were played together with both learners alone, in order.
    """

    def __init__(
        self, folder: Folder, points: Sequence[Point], learners: Mapping[str, Sequence[str]], roles: SwitchRoles
    ) -> None:
        self.roles = roles
        self._learners = learners
        self._early, self._late = learners[roles.early][0], learners[roles.late][0]
        self._alone = {
            point: curves
            for point in points
            if point[0] in (roles.early, roles.late)
            and (curves := read_curves(folder, *point, columns=["return", "length"]))
        }
        self.ensembles = {
            point: curves
            for point in points
            if {self._early, self._late} <= set(learners.get(point[0], ()))
            and self._solo(roles.early, point[1])
            and self._solo(roles.late, point[1])
            and (curves := read_curves(folder, *point, columns=["selected", "length"]))
        }

    def rows(self) -> Any:
        """A data frame with one row per run of an ensemble whose learners alone have that run too.

        Columns: ``arm``, ``sweep``, ``run_index``; ``crossover_step``, ``episode_at_crossover``; ``switch_episode``,
        ``switch_step``; ``episodes``, ``steps`` of the run; ``censored``; ``delay`` in episodes, ``delay_steps``, and
        ``delay_share`` of the run's episodes. NaN is "never"; a censored run's delays are lower bounds.

        Raises
        ------
        IncompleteError
            If not every episode was recorded.
        """
        found = pd.DataFrame([row for point in self.ensembles for row in self._rows_of(point)], columns=list(_COLUMNS))
        return found.astype(_COLUMNS)

    def gaps_and_shares(self, point: Point) -> tuple[Floats, Floats, Floats]:
        """Over a common grid of environment steps: the late learner's curve minus the early one's; its share.

        Returns
        -------
        ``float64[points]``, the steps, and ``float64[runs, points]`` twice, of runs that both learners and the ensemble
        have; the points are where all of these runs have begun and none has ended.
        """
        every = early, late, ensemble = self._of(point)
        rows = _common_rows(*every)
        last = min(each.num_steps[own].min() for each, own in zip(every, rows, strict=True))
        steps = np.linspace(0.0, last, _GRID + 1)[1:]
        at_early, at_late = (at_steps(self._curve(each), each.ends, steps) for each in (early, late))
        shares = at_steps(moving_mean(self._is_late(point), self.roles.window), ensemble.ends, steps)[rows[2]]
        gaps = at_late[rows[1]] - at_early[rows[0]]
        known = np.isfinite(gaps).all(axis=0) & np.isfinite(shares).all(axis=0)
        return steps[known], gaps[:, known], shares[:, known]

    def _of(self, point: Point) -> tuple[Curves, Curves, Curves]:
        early, late = (self._solo(role, point[1]) for role in (self.roles.early, self.roles.late))
        if early is None or late is None:
            message = f"found {point} beside {sorted(self._alone)}, expected {self.roles.early} and {self.roles.late}"
            raise KeyError(message)
        return early, late, self.ensembles[point]

    def _solo(self, arm: str, sweep: str) -> Curves | None:
        """A learner alone: at the same sweep point, or at its only one, where the axis does not touch it."""
        found = {label: curves for (name, label), curves in self._alone.items() if name == arm}
        return found.get(sweep) or (next(iter(found.values())) if len(found) == 1 else None)

    def _curve(self, curves: Curves) -> Floats:
        return moving_mean(curves.values("return"), self.roles.window)

    def _is_late(self, point: Point) -> Floats:
        """1 where the late learner was selected, else 0; NaN after the end of a run."""
        late = [place for place, name in enumerate(self._learners[point[0]]) if name == self._late]
        selected = self.ensembles[point].values("selected")
        return np.where(np.isnan(selected), np.nan, np.isin(selected, late))

    def _rows_of(self, point: Point) -> Iterator[tuple[object, ...]]:
        early, late, ensemble = self._of(point)
        of_early, of_late, is_late = self._curve(early), self._curve(late), self._is_late(point)
        for one, other, own in zip(*_common_rows(early, late, ensemble), strict=True):
            curves = *_known(of_early[one], early.ends[one]), *_known(of_late[other], late.ends[other])
            selected, ends = _known(is_late[own], ensemble.ends[own])
            found = switch_delay(crossover_step(*curves), selected == 1.0, ends, self.roles.window)
            yield (
                *point, ensemble.run_index[own], found.crossover_step, found.episode_at_crossover,
                found.switch_episode, found.switch_step, found.num_episodes, found.num_steps, found.censored,
                found.episodes, found.steps, found.episodes / found.num_episodes,
            )  # fmt: skip


_COLUMNS = {
    "arm": "object", "sweep": "object", "run_index": "int64", "crossover_step": "float64",
    "episode_at_crossover": "float64", "switch_episode": "float64", "switch_step": "float64", "episodes": "int64",
    "steps": "float64", "censored": "bool", "delay": "float64", "delay_steps": "float64", "delay_share": "float64",
}  # fmt: skip


def _common_rows(*every: Curves) -> list[NDArray[np.int64]]:
    """Of each its rows of the runs that all of them have."""
    common = reduce(np.intersect1d, [each.run_index for each in every])
    return [np.searchsorted(each.run_index, common) for each in every]


def _known(values: Floats, ends: Floats) -> tuple[Floats, Floats]:
    """A run's own episodes, without what fills its row up to the longest run."""
    count = int(np.isfinite(ends).sum())
    return values[:count], ends[:count]
