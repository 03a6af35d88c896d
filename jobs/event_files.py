"""The progress of a job as TensorBoard event files, one folder per arm; needs the extra ``apel[tensorboard]``."""

from __future__ import annotations

import time
from typing import Any

from cluster.events import ShardEvent
from cluster.shard import Shard
from jobs.observers import Ending, Observer
from jobs.progress import ArmProgress, JobProgress
from jobs.yaml_source import SpecError

_PAUSE_SECONDS = 1.0


class EventFiles(Observer):
    """Writes scalars against episodes per run, at most once a second, and at the end.

    Raises
    ------
    SpecError
        If the package that writes event files is not installed.
    """

    def __init__(self, folder: str) -> None:
        try:
            from tensorboardX import SummaryWriter
        except ImportError as error:
            message = "--tensorboard: found no tensorboardX, expected it to be installed: pip install apel[tensorboard]"
            raise SpecError(message) from error
        self._new_writer, self._folder = SummaryWriter, folder
        self._writers: dict[str, Any] = {}
        self._progress: JobProgress | None = None
        self._last = 0.0

    def planned(self, progress: JobProgress) -> None:
        """Remember whose progress it is."""
        self._progress = progress

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        """Write now and then."""
        if time.monotonic() - self._last >= _PAUSE_SECONDS:
            self._write()

    def ended(self, ending: Ending) -> None:
        """Write the end, and close the files."""
        self._write()
        for writer in self._writers.values():
            writer.close()

    def _write(self) -> None:
        self._last = time.monotonic()
        for name, arm in (self._progress.arms() if self._progress else {}).items():
            if arm.episodes:
                self._write_arm(name, arm)

    def _write_arm(self, name: str, arm: ArmProgress) -> None:
        if name not in self._writers:
            self._writers[name] = self._new_writer(f"{self._folder}/{name}")
        episode = round(arm.episodes_per_run)
        for tag, value in scalars(arm).items():
            self._writers[name].add_scalar(tag, value, episode)


def scalars(arm: ArmProgress) -> dict[str, float]:
    """What is written of an arm, by tag.

    >>> scalars(ArmProgress(runs_done=3, mean_return=-0.5, selection_share={"Q": 1.0}))
    {'runs_done': 3.0, 'mean_return': -0.5, 'selection_share/Q': 1.0}
    """
    values = {"runs_done": float(arm.runs_done), "mean_return": arm.mean_return, "mean_train_time": arm.mean_train_time}
    values |= {f"selection_share/{learner}": share for learner, share in arm.selection_share.items()}
    values |= {f"concentration/{learner}": value for learner, value in arm.concentration.items()}
    return {tag: value for tag, value in values.items() if value is not None}
