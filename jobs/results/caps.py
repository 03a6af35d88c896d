"""What runs count with that never met their criterion: the cap on episodes, also where `steps` ended them before."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.compute as pc

from jobs.experiment.axes import axis_paths
from jobs.experiment.spec import Experiment
from jobs.experiment.sweep import arm_points

_TIMES = ("train_time", "adaptation_time")


def has_censored(runs: pa.Table) -> bool:
    """Whether any run did not meet the criterion."""
    return "censored" in runs.column_names and bool(pc.any(runs["censored"].cast(pa.bool_())).as_py())


def counted_with_cap(runs: pa.Table, experiment: Experiment) -> pa.Table:
    """Run rows for means and pictures of times, in which a censored run has at least the time of the cap.

    The rows that are stored tell how many episodes were played. Where ``steps`` end runs these may be few, and an arm
    that never got there would look like a fast one. Of how long runs were watched (`jobs.analysis.statistics.survival`)
    the stored rows tell the truth.
    """
    if not has_censored(runs) or not _may_end_before(experiment):
        return runs
    caps = {one.point.label: one.point.experiment.episodes for one in arm_points(experiment)}
    cap = pa.array([caps.get(label) for label in runs["sweep"].to_pylist()], pa.int64())
    missing = pc.max_element_wise(pc.subtract(cap, runs["train_time"]), 0)
    missing = pc.if_else(pc.fill_null(runs["censored"], fill_value=False), pc.fill_null(missing, 0), 0)
    for place, name in enumerate(runs.column_names):
        if name in _TIMES:
            runs = runs.set_column(place, name, pc.add(runs[name], missing))
    return runs


def _may_end_before(experiment: Experiment) -> bool:
    """Whether something else than the cap may end a run that does not meet the criterion."""
    swept = (path for axis, values in experiment.sweep.items() for path in axis_paths(axis, values))
    return experiment.steps is not None or "steps" in swept
