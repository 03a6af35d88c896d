"""What a job says of itself as tables for people; see `jobs.progress.status_file`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from jobs.analysis.pages.fitting_table import FittingTable
from jobs.analysis.pages.results_table import short_count
from jobs.progress.pace import clock

if TYPE_CHECKING:
    from jobs.remote.status import Status


def jobs_table(found: Iterable[Status]) -> FittingTable:
    """One row per job."""
    rows = [[one.job, one.state, *totals(one.progress)] for one in found]
    headings = ("job", "state", "runs", "of", "steps/s", "time")
    return FittingTable(headings, rows, names=("job", "state"), first_to_go=("steps/s", "time", "of", "runs"))


def totals(progress: dict[str, Any] | None) -> tuple[str, str, str, str]:
    """Runs done, runs planned, steps per second and time, of a job."""
    if progress is None:
        return "-", "-", "-", "-"
    arms = progress["arms"].values()
    steps = sum(arm["steps"] for arm in arms) / max(progress["seconds"], 1e-9)
    done, planned = (sum(arm[name] for arm in arms) for name in ("runs_done", "runs_planned"))
    return str(done), str(planned), short_count(steps), f"{progress['seconds']:,.0f} s"


def time_left(progress: dict[str, Any]) -> str:
    """How long a job has been running and about how long it may still take; empty where that is not known.

    >>> time_left({"seconds": 75.0, "seconds_left": 3725.4}), time_left({"seconds": 75.0})
    ('0:01:15 so far, about 1:02:05 left', '')
    """
    left = progress.get("seconds_left")
    return "" if left is None else f"{clock(progress['seconds'])} so far, about {clock(left)} left"


def arms_table(progress: dict[str, Any]) -> FittingTable:
    """One row per arm."""
    headings = ("arm", "runs", "failed", "episodes", "steps", "mean return", "train time", "selected")
    rows = [_arm_row(name, arm) for name, arm in progress["arms"].items()]
    first_to_go = ("selected", "train time", "steps", "failed")
    return FittingTable(headings, rows, names=("arm", "selected"), first_to_go=first_to_go)


def _arm_row(name: str, arm: dict[str, Any]) -> list[str]:
    share = arm["episodes"] / arm["episodes_planned"] if arm["episodes_planned"] else 1.0
    return [
        name,
        f"{arm['runs_done']} of {arm['runs_planned']}",
        str(arm["runs_failed"]),
        f"{share:.0%}".replace("%", " %"),
        short_count(arm["steps"]),
        "-" if arm["mean_return"] is None else f"{arm['mean_return']:,.2f}",
        "-" if arm["mean_train_time"] is None else f"{arm['mean_train_time']:,.0f}",
        ", ".join(f"{learner} {part:.0%}" for learner, part in arm["selection_share"].items()).replace("%", " %"),
    ]
