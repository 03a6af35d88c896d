"""The progress of a job as TensorBoard event files, one folder per arm; needs the extra ``apel[tensorboard]``.

TensorBoard knows one axis, whole numbers, so that every quantity is there twice: against the episodes that a run of the
arm has played, on average, and below ``by_steps/`` against its environment steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jobs.progress.job_observer import JobInfo, begun, scalars
from jobs.progress.observers import Ending
from jobs.progress.progress import ArmProgress


class EventFiles:
    """Writes scalars against episodes and against steps per run, below ``folder``; see `JobObserver`."""

    def __init__(self, folder: str) -> None:
        self._folder = folder
        self._writers: dict[str, Any] = {}

    def begin(self, job: JobInfo) -> None:
        """See `JobObserver`; an arm's files are made when it begins."""

    def progress(self, arms: Mapping[str, ArmProgress]) -> None:
        """Write what is known of each arm."""
        from tensorboardX import SummaryWriter

        for name, arm in begun(arms).items():
            if name not in self._writers:
                self._writers[name] = SummaryWriter(f"{self._folder}/{name}")
            writer, episode, step = self._writers[name], round(arm.episodes_per_run), round(arm.steps_per_run)
            for tag, value in scalars(arm).items():
                writer.add_scalar(tag, value, episode)
                writer.add_scalar(f"by_steps/{tag}", value, step)

    def end(self, ending: Ending) -> None:
        """Close the files."""
        for writer in self._writers.values():
            writer.close()
