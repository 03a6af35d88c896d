"""The runs behind a figure: which rows it shows, and what those of one arm and sweep point say together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from jobs.analysis.statistics.bootstrap import Floats, bootstrap_interval
from jobs.experiment.figures import ArmPlot, CurvePlot, LinePlot, Metric
from jobs.experiment.spec import Experiment
from jobs.results.caps import counted_with_cap

NAMES: dict[Metric, str] = {
    "train_time": "train time (episodes)",
    "adaptation_time": "adaptation time (episodes)",
    "steady_state": "steady-state return",
}


@dataclass(frozen=True)
class Sample:
    """One metric of the runs of an arm at a sweep point."""

    arm: str
    sweep: str
    values: Floats
    censored: NDArray[np.bool_]

    @property
    def label(self) -> str:
        """The arm, and the sweep point on a line of its own."""
        return f"{self.arm}\n{self.sweep}" if self.sweep else self.arm

    @property
    def num_censored(self) -> int:
        """Runs at the cap."""
        return int(self.censored.sum())

    @property
    def mean(self) -> float:
        """Over all runs; those at the cap count as the cap."""
        return float(self.values.mean())

    @property
    def deviation(self) -> float:
        """Standard deviation; 0 of a single run."""
        return float(self.values.std(ddof=1)) if len(self.values) > 1 else 0.0

    @property
    def spread(self) -> tuple[float, float]:
        """The mean less and plus the standard deviation, but not beyond the least and the greatest run."""
        low, high = self.mean - self.deviation, self.mean + self.deviation
        return max(low, float(self.values.min())), min(high, float(self.values.max()))

    @cached_property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mean."""
        return bootstrap_interval(self.values)


def selected(runs: pa.Table, plot: ArmPlot | LinePlot | CurvePlot, experiment: Experiment) -> Any:
    """The rows that a plot shows, as a data frame, in the order of its arms.

    Those that did not meet the criterion count with the cap, except where it is drawn how long each was watched.
    """
    is_watched = isinstance(plot, ArmPlot) and plot.kind == "survival"
    frame = (runs if is_watched else counted_with_cap(runs, experiment)).to_pandas()
    for column, values in plot.where.items():
        if column in frame:
            frame = frame[[_is_wanted(found, values) for found in frame[column]]]
    order = plot.arms or [*experiment.arms, *experiment.hindsight]
    place = {arm: position for position, arm in enumerate(order)}
    frame = frame[frame["arm"].isin(order)]
    return frame.sort_values("arm", key=lambda arms: arms.map(place), kind="stable")


def samples(frame: Any, metric: Metric) -> list[Sample]:
    """One sample for each arm and sweep point whose runs have the metric."""
    known = frame[frame[metric].notna()]
    return [sample(rows, metric) for _, rows in known.groupby(["arm", "sweep"], sort=False)]


def sample(rows: Any, metric: Metric) -> Sample:
    """The sample of the rows of one arm and sweep point."""
    values = rows[metric].to_numpy(dtype=np.float64)
    censored = np.zeros(len(values), dtype=np.bool_)
    if metric != "steady_state":
        censored = rows["censored"].fillna(value=False).to_numpy(dtype=np.bool_)
    return Sample(str(rows["arm"].iloc[0]), str(rows["sweep"].iloc[0]), values, censored)


def cap(experiment: Experiment, metric: Metric) -> float | None:
    """The longest time that a run can have; None where runs or sweep points differ, and where there is none."""
    swept = {
        path for axis, paths in experiment.sweep.items() for path in (paths if isinstance(paths, dict) else [axis])
    }
    if metric == "steady_state" or experiment.criterion is None or swept & {"episodes", "criterion.after"}:
        return None
    after = experiment.criterion.after if metric == "adaptation_time" else 0
    return None if isinstance(after, str) else float(experiment.episodes - after)


def count_of_runs(all_samples: Sequence[Sample]) -> str:
    """``100 runs``; where samples differ, from the fewest to the most."""
    counts = sorted({len(one.values) for one in all_samples})
    return f"{counts[0]} runs" if len(counts) == 1 else f"{counts[0]} to {counts[-1]} runs"


def _is_wanted(found: Any, values: Sequence[Any]) -> bool:
    if found is None or (isinstance(found, float) and math.isnan(found)):
        return True
    return any(str(found) == str(value) or _is_same_number(found, value) for value in values)


def _is_same_number(found: Any, value: Any) -> bool:
    try:
        return float(found) == float(value)
    except (TypeError, ValueError):
        return False
