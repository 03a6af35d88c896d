"""The progress of a job in Weights & Biases, one run per arm and session; needs the extra ``apel[wandb]``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, Literal

from jobs.progress.job_observer import JobInfo, begun, scalars
from jobs.progress.observers import Ending
from jobs.progress.progress import ArmProgress

Mode = Literal["offline", "online", "disabled", "shared"]


class WandbRuns:
    """Writes metrics beside the episodes and steps per run; see `JobObserver`.

    Parameters
    ----------
    folder:
        Where wandb keeps its files, below ``wandb/``.
    mode:
        ``offline`` writes files, and sends nothing: ``wandb sync`` does. Others are those of wandb.
    """

    def __init__(self, folder: str, mode: Mode) -> None:
        self._folder, self._mode = folder, mode
        self._job: JobInfo | None = None
        self._runs: dict[str, Any] = {}

    def begin(self, job: JobInfo) -> None:
        """See `JobObserver`; an arm's run is made when it begins."""
        # wandb would tell its makers of its own errors.
        os.environ.setdefault("WANDB_ERROR_REPORTING", "false")
        self._job = job

    def progress(self, arms: Mapping[str, ArmProgress]) -> None:
        """Write what is known of each arm."""
        for name, arm in begun(arms).items():
            if name not in self._runs:
                self._runs[name] = self._new_run(name)
            self._runs[name].log({"episodes": arm.episodes_per_run, "steps": arm.steps_per_run, **scalars(arm)})

    def end(self, ending: Ending) -> None:
        """Close the runs."""
        for run in self._runs.values():
            run.finish(exit_code=0 if ending == "done" else 1)

    def _new_run(self, arm: str) -> Any:
        import wandb

        job = self._job
        assert job is not None  # noqa: S101 - the protocol says so
        os.makedirs(self._folder, exist_ok=True)  # noqa: PTH103 - otherwise wandb writes into the system's temporary one
        run = wandb.init(
            project=os.environ.get("WANDB_PROJECT", job.experiment),
            group=job.identity,
            name=arm,
            config={"identity": job.identity, "results": job.results, "arm": arm, "experiment": dict(job.content)},
            dir=self._folder,
            mode=self._mode,
            reinit="create_new",
            # The terminal is ours; and a question would be asked where nobody answers.
            settings=wandb.Settings(console="off", silent=True),
        )
        run.define_metric("*", step_metric="episodes")
        return run
