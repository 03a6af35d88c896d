"""What one's own code is told of a job: the interface behind ``--log``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from jobs.progress.observers import Ending
from jobs.progress.progress import ArmProgress


@dataclass(frozen=True)
class JobInfo:
    """Which job it is.

    Attributes
    ----------
    experiment, identity:
        Its name and its identity, as in the path of its results.
    results:
        Path or URI of its results, without credentials.
    job:
        Id of the submitted job; empty for none.
    content:
        The experiment, as in its file: ``content["arms"]`` has the arms by name.
    """

    experiment: str
    identity: str
    results: str
    job: str
    content: Mapping[str, Any]


class JobObserver(Protocol):
    """Told how a job goes on, in the process that leads it and in a thread of its own, one call after the other.

    The job does not wait for it while it runs: an observer that takes its time is told less often. What it raises is
    told to the user once, and the job goes on.
    """

    def begin(self, job: JobInfo) -> None:
        """There is something to play. An observer that raises here is told nothing more."""

    def progress(self, arms: Mapping[str, ArmProgress]) -> None:
        """How far each arm has come, by name: at most once a second, and at the end.

        See `jobs.progress.progress.ArmProgress`: what it says of returns and shares is of the latest episodes.
        """

    def end(self, ending: Ending) -> None:
        """The job is over: ``done``, ``failed`` (some runs), ``stopped`` (it was asked to) or ``broken``."""


def scalars(arm: ArmProgress) -> dict[str, float]:
    """What a logger writes of an arm, by tag.

    >>> scalars(ArmProgress(runs_done=3, mean_return=-0.5, selection_share={"Q": 1.0}))
    {'runs_done': 3.0, 'mean_return': -0.5, 'selection_share/Q': 1.0}
    """
    values = {"runs_done": float(arm.runs_done), "mean_return": arm.mean_return, "mean_train_time": arm.mean_train_time}
    values |= {f"selection_share/{learner}": share for learner, share in arm.selection_share.items()}
    values |= {f"concentration/{learner}": value for learner, value in arm.concentration.items()}
    return {tag: value for tag, value in values.items() if value is not None}


def begun(arms: Mapping[str, ArmProgress]) -> dict[str, ArmProgress]:
    """Those of which something was played in this session."""
    return {name: arm for name, arm in arms.items() if arm.episodes}
