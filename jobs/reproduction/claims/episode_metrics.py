"""Metrics of claims that are made of recorded episodes: means over windows, over parts of the steps, switch delays.

Each gives a data frame with ``arm``, ``sweep``, ``run_index``, the metric, and window or part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.compute as pc
from numpy.typing import NDArray

from jobs.analysis.recorded_episodes import IncompleteError
from jobs.analysis.statistics.bootstrap import Floats
from jobs.analysis.switching.runs import Point, SwitchData
from jobs.reproduction.claims.selection import PART, WINDOW, MissingError, Selection
from jobs.results.episodes import read_episodes
from jobs.results.storage import Folder

_RUN = ["sweep", "run_index"]


def of_episodes(
    folder: Folder, selection: Selection, points: Sequence[Point], learners: Mapping[str, list[str]]
) -> Any:
    """One row per run (and window), of all arms.

    Parameters
    ----------
    folder, selection:
        Of the results, and what is asked of them.
    points:
        Arms and sweep points that were played.
    learners:
        Of each arm.

    Raises
    ------
    MissingError
        If nothing of an arm was recorded, or no run has what is asked for.
    IncompleteError
        If environment steps are asked for, and not every episode was recorded.
    """
    if selection.switch:
        return _switch_delays(folder, selection, points, learners)
    of_arm = _means_over_parts if selection.parts else _means_over_windows
    return pd.concat([of_arm(folder, arm, selection).assign(arm=arm) for arm in selection.arms], ignore_index=True)


def _switch_delays(
    folder: Folder, selection: Selection, points: Sequence[Point], learners: Mapping[str, list[str]]
) -> Any:
    """Of runs with a crossover; censored runs count with a lower bound."""
    roles = selection.switch
    if roles is None:
        return pd.DataFrame()
    data = SwitchData(
        folder, [p for p in points if p[0] in (*selection.arms, roles.early, roles.late)], learners, roles
    )
    rows = data.rows()
    if missing := [arm for arm in selection.arms if arm not in set(rows["arm"])]:
        message = f"no recorded episodes of {', '.join(missing)} beside {roles.early} and {roles.late}"
        raise MissingError(message)
    rows = rows.rename(columns={"delay": "switch_delay", "delay_steps": "switch_delay_steps"})
    rows = rows.rename(columns={"delay_share": "switch_delay_share"})
    known = rows[rows["crossover_step"].notna()]
    if known.empty:
        message = f"no run in which {roles.late} stays above {roles.early} in the end"
        raise MissingError(message)
    return known[["arm", *_RUN, selection.metric, "censored"]]


def _means_over_windows(folder: Folder, arm: str, selection: Selection) -> Any:
    first, last = selection.windows[0][0], selection.windows[-1][1]
    frame = _read(folder, arm, selection, ["episode"], within=(first, last))
    starts, ends = _edges(selection.windows)
    window = np.searchsorted(starts, frame["episode"].to_numpy(), side="right") - 1
    return _means(frame, WINDOW, starts[window], frame["episode"].to_numpy() <= ends[window], selection.metric)


def _means_over_parts(folder: Folder, arm: str, selection: Selection) -> Any:
    """Of the episodes that end in a part of the environment steps of their run, ``(from, to]`` of 1."""
    frame = _read(folder, arm, selection, ["episode", "length"]).sort_values([*_RUN, "episode"])
    by_run = frame.groupby(_RUN, sort=False)
    if (by_run["episode"].transform("max") + 1 != by_run["episode"].transform("size")).any():
        message = f"found runs of {arm} with episodes that were not recorded, expected record: all"
        raise IncompleteError(message)
    place = (by_run["length"].cumsum() / by_run["length"].transform("sum")).to_numpy()
    starts, ends = _edges(selection.parts)
    part = np.maximum(np.searchsorted(starts, place, side="left") - 1, 0)
    return _means(frame, PART, starts[part], (place > starts[part]) & (place <= ends[part]), selection.metric)


def _read(
    folder: Folder,
    arm: str,
    selection: Selection,
    columns: Sequence[str],
    within: tuple[float, float] | None = None,
) -> Any:
    """Recorded episodes; only those ``within`` the first and the last, where it is given."""
    table = read_episodes(folder, arm, [*_RUN, *columns, selection.metric])
    if table is None:
        message = f"no recorded episodes of {arm}"
        raise MissingError(message)
    if within is not None:
        episode, (first, last) = table["episode"], within
        table = table.filter(pc.and_(pc.greater_equal(episode, first), pc.less_equal(episode, last)))
    if selection.learner is not None:
        place = table.column_names.index(selection.metric)
        table = table.set_column(place, selection.metric, pc.list_element(table[selection.metric], selection.learner))
    return table.to_pandas()


def _edges(windows: Sequence[tuple[float, float]]) -> tuple[Floats, Floats]:
    starts, ends = np.array(windows).T
    return starts, ends


def _means(frame: Any, axis: str, window: Any, inside: NDArray[np.bool_], metric: str) -> Any:
    found = frame[[*_RUN, metric]].assign(**{axis: window})[inside]
    return found.groupby([*_RUN, axis], as_index=False)[metric].mean()
