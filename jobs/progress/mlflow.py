"""The progress of a job in MLflow, one run per arm and session; needs the extra ``apel[mlflow]``.

MLflow's axis is whole numbers, as TensorBoard's: see `jobs.progress.tensorboard`.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Mapping
from typing import Any

from jobs.progress.job_observer import JobInfo, begun, scalars
from jobs.progress.observers import Ending
from jobs.progress.progress import ArmProgress

_STATUS: dict[Ending, str] = {"done": "FINISHED", "failed": "FAILED", "stopped": "KILLED", "broken": "FAILED"}
_MOST_CHARACTERS = 500


class MlflowRuns:
    """Writes metrics against episodes and against steps per run, to the tracking server or database at ``uri``.

    The MLflow experiment is called as ours, its runs as the arms; tags tell the identity and where the results are.
    See `JobObserver`.
    """

    def __init__(self, uri: str) -> None:
        self._uri = uri
        self._client: Any = None
        self._experiment = ""
        self._job: JobInfo | None = None
        self._runs: dict[str, str] = {}

    def begin(self, job: JobInfo) -> None:
        """Find or make the MLflow experiment."""
        # MLflow would tell its makers what is used, at import and later.
        os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
        from mlflow import MlflowClient

        for name in ("mlflow", "alembic"):
            logging.getLogger(name).setLevel(logging.WARNING)
        self._job, self._client = job, MlflowClient(tracking_uri=self._uri)
        found = self._client.get_experiment_by_name(job.experiment)
        self._experiment = found.experiment_id if found else self._client.create_experiment(job.experiment)

    def progress(self, arms: Mapping[str, ArmProgress]) -> None:
        """Write what is known of each arm."""
        from mlflow.entities import Metric

        now = round(1000 * time.time())
        for name, arm in begun(arms).items():
            if name not in self._runs:
                self._runs[name] = self._new_run(name)
            metrics = []
            for tag, value in scalars(arm).items():
                key = metric_name(tag)
                metrics.append(Metric(key, value, now, round(arm.episodes_per_run)))
                metrics.append(Metric(f"by_steps/{key}", value, now, round(arm.steps_per_run)))
            self._client.log_batch(self._runs[name], metrics=metrics)

    def end(self, ending: Ending) -> None:
        """Say of every run how it ended."""
        for run in self._runs.values():
            self._client.set_terminated(run, status=_STATUS[ending])

    def _new_run(self, arm: str) -> str:
        from mlflow.entities import Param

        job = self._job
        assert job is not None  # noqa: S101 - the protocol says so
        tags = {"identity": job.identity, "results": job.results, "job": job.job, "arm": arm}
        run = self._client.create_run(
            self._experiment, run_name=arm, tags={f"apel.{name}": value for name, value in tags.items() if value}
        )
        content = {name: job.content[name] for name in ("runs", "seed", "episodes") if name in job.content}
        params = flattened(content | dict(job.content["arms"][arm]))
        self._client.log_batch(run.info.run_id, params=[Param(name, value) for name, value in params.items()])
        return str(run.info.run_id)


def metric_name(tag: str) -> str:
    """The tag in the characters that MLflow takes, two tags never as one: no name of ours has a blank.

    >>> metric_name("selection_share/Q+")
    'selection_share/Q plus '
    """
    return tag.replace("+", " plus ")


def flattened(content: Mapping[str, Any], before: str = "") -> dict[str, str]:
    """Mappings within mappings as one, with texts of what MLflow holds.

    >>> flattened({"learners": ["Q"], "selector": {"type": "apel", "decay": 0.01}})
    {'learners': "['Q']", 'selector.type': 'apel', 'selector.decay': '0.01'}
    """
    found: dict[str, str] = {}
    for name, value in content.items():
        key = metric_name(f"{before}{name}")
        found |= flattened(value, f"{key}.") if isinstance(value, Mapping) else {key: str(value)[:_MOST_CHARACTERS]}
    return found
