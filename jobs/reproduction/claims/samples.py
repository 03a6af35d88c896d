"""From stored results to the numbers that a claim is about: runs side by side, by arm and point of an axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from jobs.experiment.figures import check_roles
from jobs.experiment.spec import Experiment
from jobs.reproduction.claims.episode_metrics import of_episodes
from jobs.reproduction.claims.selection import Given, MissingError, Selection, UnknownNameError
from jobs.reproduction.claims.statistics import Sample
from jobs.results.caps import counted_with_cap
from jobs.results.hindsight import with_hindsight
from jobs.results.store import ResultStore


@dataclass(frozen=True)
class Selected:
    """The sample, and which of its runs were censored where, ``bool[runs, arms, points]``."""

    sample: Sample
    censored_at: NDArray[np.bool_]

    @property
    def censored(self) -> NDArray[np.bool_]:
        """``bool[runs]``: at any point."""
        by_run: NDArray[np.bool_] = np.logical_or.reduce(self.censored_at, axis=(1, 2))
        return by_run


class Results:
    """The stored results of one experiment, read once.

    Parameters
    ----------
    store:
        Where they are.
    experiment:
        Whose they are. What is no part of its identity is taken from here, and not from what stands with the results:
        the arms of hindsight are picked anew.
    """

    def __init__(self, store: ResultStore, experiment: Experiment) -> None:
        self.store = store
        self.experiment = experiment

    @cached_property
    def runs(self) -> Any:
        """The run rows as a pandas frame; those that did not meet the criterion count with the cap."""
        return counted_with_cap(self._with_hindsight(self.store.runs()), self.experiment).to_pandas()

    def _with_hindsight(self, stored: pa.Table) -> pa.Table:
        if not self.experiment.hindsight:
            return stored
        played = stored.filter(pc.is_in(stored["arm"], pa.array(list(self.experiment.arms))))
        kept = [name for name in played.column_names if name != "chosen"]
        return with_hindsight(played.select(kept), self.experiment.hindsight)

    def select(self, selection: Selection) -> Selected:
        """The numbers that are asked for.

        Raises
        ------
        UnknownNameError
            If an arm or a column is none of the experiment's, or a run has several rows where one is expected.
        MissingError
            If rows are missing.
        """
        self._expect_known(selection)
        frame = self.runs[self.runs["arm"].isin(selection.arms)]
        axis = selection.axis or selection.implied_axis
        if not selection.is_of_runs:
            frame = self._with_episodes(frame, selection)
        for column, value in selection.where.items():
            frame = _where(frame, column, value)
        if selection.given:
            frame = frame[frame["run_index"].isin(self._runs_given(selection.given, selection.where))]
        if selection.metric not in frame:
            raise MissingError(_missing(self, f"no {selection.metric}"))
        points = _points(self, frame, axis, selection)
        needed = dict.fromkeys(("run_index", "censored", selection.metric, *selection.pool, axis))
        columns = []
        for arm in selection.arms:
            rows = frame.loc[frame["arm"] == arm, [name for name in needed if name in frame]]
            rows = rows.dropna(subset=[selection.metric])
            columns.append([self._column(rows, arm, axis, point, selection) for point in points])
        return self._side_by_side(columns, points, selection)

    def _expect_known(self, selection: Selection) -> None:
        experiment = self.experiment
        arms = [*experiment.arms, *experiment.hindsight]
        known = {*self.runs.columns, *experiment.sweep, *experiment.variables}
        columns = [*selection.where, *selection.pool, *([selection.axis] if selection.axis else [])]
        columns += [selection.metric] if selection.is_of_runs else []
        named = [*selection.arms, *([selection.given.arm] if selection.given else [])]
        for kind, names, expected in (("arm", named, arms), ("column", columns, sorted(known))):
            for name in names:
                if name not in expected:
                    message = f"found {kind} {name!r}, expected some of {', '.join(expected)} of {experiment.name}"
                    raise UnknownNameError(message)

    def _runs_given(self, given: Given, where: Mapping[str, Any]) -> list[int]:
        """Indices of the runs in which an arm was censored, or was not."""
        rows = self.runs[self.runs["arm"] == given.arm]
        for column, value in where.items():
            rows = _where(rows, column, value)
        if rows["run_index"].duplicated().any():
            message = f"given: found several rows of a run of {given.arm}, expected one: name a value in where"
            raise UnknownNameError(message)
        found: list[int] = rows.loc[(rows["censored"] == True) == given.censored, "run_index"].tolist()  # noqa: E712
        return found

    def _column(self, rows: Any, arm: str, axis: str | None, point: Any, selection: Selection) -> Any:
        """One arm at one point: value and censoring by run."""
        if axis is not None and axis in rows:
            rows = rows[(rows[axis] == point) | rows[axis].isna()]
        if rows.empty:
            raise MissingError(_missing(self, f"no runs of {arm}" + (f" at {axis} {point}" if axis else "")))
        keys = ["run_index", *(column for column in selection.pool if column in rows)]
        if rows.duplicated(keys).any():
            sweeps = ", ".join(self.experiment.sweep)
            message = f"found several rows of a run of {arm}, expected one: name {sweeps} in where, axis or pool"
            raise UnknownNameError(message)
        table = pd.DataFrame(
            {
                "value": rows[selection.metric].to_numpy(np.float64),
                "censored": (rows["censored"] == True).to_numpy(np.bool_),  # noqa: E712 - null is no
            },
            index=rows["run_index"].to_numpy(),
        )
        if not selection.pool:
            return table
        by_run = table.groupby(level=0)
        pooled = by_run.agg(value=("value", "mean"), censored=("censored", "any"))
        sizes = by_run.size()
        return pooled[sizes == sizes.max()]

    def _side_by_side(self, columns: list[list[Any]], points: Sequence[Any], selection: Selection) -> Selected:
        tables = [table for row in columns for table in row]
        common = sorted(set.intersection(*(set(table.index) for table in tables)))
        if not common:
            raise MissingError(_missing(self, f"no run that all of {', '.join(selection.arms)} have"))
        shape = (len(common), len(columns), len(points))
        values = np.stack([table.loc[common, "value"].to_numpy(np.float64) for table in tables], axis=1)
        censored = np.stack([table.loc[common, "censored"].to_numpy(np.bool_) for table in tables], axis=1)
        axis = [point if isinstance(point, int | float) else place for place, point in enumerate(points)]
        sample = Sample(values.reshape(shape), np.array(axis, dtype=np.float64))
        return Selected(sample, censored.reshape(shape))

    def _with_episodes(self, frame: Any, selection: Selection) -> Any:
        """The run rows with what their recorded episodes say; once per window where there are several."""
        learners = {arm: spec.learner_names for arm, spec in self.experiment.arms.items()}
        if selection.switch:
            try:
                check_roles("switch", selection.switch, learners)
            except ValueError as error:
                raise UnknownNameError(str(error)) from error
        points = list(self.runs[["arm", "sweep"]].drop_duplicates().itertuples(index=False, name=None))
        try:
            found = of_episodes(self.store.folder, selection, points, learners)
        except MissingError as error:
            raise MissingError(_missing(self, str(error))) from error
        own = [name for name in frame.columns if name in found.columns and name not in ("arm", "sweep", "run_index")]
        return frame.drop(columns=own).merge(found, on=["arm", "sweep", "run_index"])


def _where(frame: Any, column: str, value: Any) -> Any:
    """Rows with a value of a column, and those without any."""
    return frame[(frame[column] == value) | frame[column].isna()] if column in frame else frame


def _points(results: Results, frame: Any, axis: str | None, selection: Selection) -> Sequence[Any]:
    """Values of the axis, in order; one nameless point without an axis."""
    if axis is None:
        return [None]
    if selection.values is not None:
        return selection.values
    found = sorted(frame[axis].dropna().unique().tolist()) if axis in frame else []
    if not found:
        raise MissingError(_missing(results, f"no runs with a {axis}"))
    return found


def _missing(results: Results, what: str) -> str:
    return f"{results.experiment.name}: {what}"
