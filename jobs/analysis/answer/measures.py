"""What candidates are ranked by, one number per run: from the run rows, and from what was recorded of the episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd
import pyarrow as pa

from jobs.analysis.answer.contests import Candidate
from jobs.analysis.answer.played import PlayedRuns
from jobs.analysis.statistics.bootstrap import Floats
from jobs.experiment.spec import Experiment

Kind = Literal["return", "area", "episodes", "steps"]


@dataclass(frozen=True)
class Measure:
    """One number per run and candidate.

    Attributes
    ----------
    values:
        ``float64[runs, candidates]`` in the order of the runs' indices; NaN where a candidate has no such run.
    num_at_cap:
        Runs of each candidate that did not meet the criterion, and count with what they have played.
    """

    kind: Kind
    values: Floats
    num_at_cap: tuple[int, ...]

    @property
    def smaller_is_better(self) -> bool:
        """Of times, and not of returns."""
        return self.kind in ("episodes", "steps")


@dataclass(frozen=True)
class Measures:
    """Those that are known, the one that decides first; ``notes`` says which are not, and why."""

    known: tuple[Measure, ...]
    notes: tuple[str, ...]


def ends_when_met(experiment: Experiment) -> bool:
    """Whether runs are over once they meet the criterion: then how early that is decides, and not what they return."""
    return experiment.criterion is not None and experiment.stop_when_met


def run_rows(runs: pa.Table, candidates: Sequence[Candidate]) -> list[pd.DataFrame]:
    """The rows of each candidate, by run index."""
    frame = runs.to_pandas()
    groups = {key: group.set_index("run_index").sort_index() for key, group in frame.groupby(["arm", "sweep"])}
    empty = frame.iloc[:0].set_index("run_index")
    return [groups.get((one.point.arm, one.point.point.label), empty) for one in candidates]


def measures(experiment: Experiment, rows: Sequence[pd.DataFrame], played: Sequence[PlayedRuns]) -> Measures:
    """All measures of some candidates; of each its rows, and what its recorded episodes say."""
    at_cap = tuple(int(part["censored"].astype(float).fillna(0).sum()) for part in rows)
    nobody = (0,) * len(rows)
    found: list[Measure] = []
    notes: list[str] = []

    def take(kind: Kind, columns: Sequence[Mapping[int, float]], capped: tuple[int, ...], why_not: str) -> None:
        values = _side_by_side(rows, columns)
        if values is None:
            notes.append(why_not)
        elif np.isinf(values).any():
            notes.append(f"the {kind} of some runs is so large that it is no finite number")
        else:
            found.append(Measure(kind, values, capped))

    if not ends_when_met(experiment):
        unknown = "the return of the last tenth is not known of every run: an older version played some"
        take("return", [_column(part, "last_tenth_return") for part in rows], nobody, unknown)
        missing = _not_recorded(experiment, "the area under the curve")
        take("area", [one.area for one in played], nobody, missing)
    if experiment.criterion is not None:
        unknown = "when the criterion was met is not known of every run"
        episodes = [_to_criterion(part, "train_time", experiment.episodes) for part in rows]
        if experiment.stop_when_met:
            steps, why_not = [_to_criterion(part, "steps", experiment.steps) for part in rows], unknown
        else:
            steps = [one.steps_to_criterion for one in played]
            why_not = "the steps to the criterion are not known: that takes record: all"
        costs: list[tuple[Kind, Sequence[Mapping[int, float]], str]]
        costs = [("episodes", episodes, unknown), ("steps", steps, why_not)]
        for kind, columns, reason in costs if experiment.steps is None else reversed(costs):
            take(kind, columns, at_cap, reason)
    return Measures(tuple(found), (*notes, *_sampled(found, played)))


def deciding(experiment: Experiment, rows: Sequence[pd.DataFrame]) -> Measure | None:
    """The measure that decides, from the run rows alone; None where it is not known of every run.

    That is the final return; where runs end when they meet the criterion, the episodes until then, or, where steps end
    them too, the steps.
    """
    known = measures(experiment, rows, [PlayedRuns() for _ in rows]).known
    cost: Kind = "episodes" if experiment.steps is None else "steps"
    kind = cost if ends_when_met(experiment) else "return"
    return next((measure for measure in known if measure.kind == kind), None)


def _column(rows: pd.DataFrame, name: str) -> dict[int, float]:
    values = rows[name].dropna() if name in rows else rows.iloc[:0]["steps"]
    return {int(index): float(value) for index, value in values.items()}


def _to_criterion(rows: pd.DataFrame, name: str, cap: int | None) -> dict[int, float]:
    """What a run took; one that did not meet the criterion counts with the cap, whichever of the caps has ended it."""
    taken = _column(rows, name)
    if cap is None:
        return taken
    missed = rows.index[rows["censored"].astype(float).fillna(0) > 0]
    return {**taken, **{int(index): max(taken.get(int(index), 0.0), float(cap)) for index in missed}}


def _side_by_side(rows: Sequence[pd.DataFrame], columns: Sequence[Mapping[int, float]]) -> Floats | None:
    """``float64[runs, candidates]``; None where one is not known of a run that is there."""
    indices = sorted({int(index) for part in rows for index in part.index})
    if not indices or any(len(column) < len(part) for part, column in zip(rows, columns, strict=True)):
        return None
    return np.array([[column.get(index, np.nan) for column in columns] for index in indices], dtype=np.float64)


def _not_recorded(experiment: Experiment, what: str) -> str:
    is_none: Any = experiment.record == "none"
    why = "with record: none no episode is" if is_none else "not every run has recorded episodes"
    return f"{what} is not known: {why}"


def _sampled(found: Sequence[Measure], played: Sequence[PlayedRuns]) -> list[str]:
    recorded, total = (sum(getattr(one, name) for one in played) for name in ("num_recorded", "num_played"))
    if recorded == total or not any(measure.kind == "area" for measure in found):
        return []
    return [f"the area is estimated from the {recorded:,} of {total:,} episodes that were recorded"]
