"""Counters and gauges of a job in Ray's own registry, from which every node of the cluster exports them to Prometheus.

The driver alone reports, for all its shards: a process that dies takes its series along, and a counter that begins
anew with every process would not say how far the job has come.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ray.util.metrics import Counter, Gauge

_LABELS = ("experiment", "apel_job")
_ARM, _LEARNER = (*_LABELS, "arm"), (*_LABELS, "arm", "learner")

COUNTERS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "apel_episodes_total": ("Episodes played; a run that is over counts with its cap.", _ARM),
    "apel_steps_total": ("Environment steps.", _ARM),
    "apel_rounds_total": ("Rounds of messages between coordinators and learners.", _ARM),
    "apel_round_seconds_total": ("Seconds spent in rounds, over all shards.", _ARM),
    "apel_checkpoint_seconds_total": ("Seconds spent in checkpoints, over all shards.", _ARM),
    "apel_restarts_total": ("Shards that began again since their processes had died.", _LABELS),
}
GAUGES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "apel_runs_planned": ("Runs of the arm.", _ARM),
    "apel_runs_done": ("Runs that are over, failed ones included.", _ARM),
    "apel_runs_failed": ("Runs that failed.", _ARM),
    "apel_mean_return": ("Mean undiscounted return of the latest episodes.", _ARM),
    "apel_mean_train_time": ("Mean train time, in episodes, of the runs finished so far.", _ARM),
    "apel_selection_share": ("Share of the latest episodes that the learner played.", _LEARNER),
    "apel_concentration": ("Mean Dirichlet concentration over the runs under way.", _LEARNER),
}
"""Name, without the ``ray_`` that Ray puts in front of it → what it says, and its labels."""


class PrometheusSeries:
    """The series of one job."""

    def __init__(self, experiment: str, job: str) -> None:
        self._labels = {"experiment": experiment, "apel_job": job}
        self._counters: dict[str, Any] = {name: Counter(name, *about) for name, about in COUNTERS.items()}
        self._gauges: dict[str, Any] = {name: Gauge(name, *about) for name, about in GAUGES.items()}
        self._totals: dict[tuple[str, str], float] = {}

    def set(self, name: str, value: float, **labels: str) -> None:
        """Set a gauge."""
        self._gauges[name].set(value, {**self._labels, **labels})

    def raise_to(self, name: str, total: float, arm: str | None = None) -> None:
        """Let a counter stand at ``total``; it stays where it is while a shard plays again what was lost."""
        key = (name, arm or "")
        more = total - self._totals.get(key, 0.0)
        if more > 0:
            self._totals[key] = total
            self._counters[name].inc(more, {**self._labels, **({"arm": arm} if arm is not None else {})})
