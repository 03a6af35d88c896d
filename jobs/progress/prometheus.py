"""The progress of a job as series that Prometheus scrapes; see `jobs.progress.prometheus_series`."""

from __future__ import annotations

import time
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

from cluster.events import ShardEvent, ShardProgress
from cluster.shard import Shard
from jobs.progress.observers import Ending, Observer
from jobs.progress.progress import ArmProgress, JobProgress

if TYPE_CHECKING:
    from jobs.progress.prometheus_series import PrometheusSeries

_PAUSE_SECONDS = 1.0


class PrometheusObserver(Observer):
    """Reports at most once a second, and at the end."""

    def __init__(self, experiment: str, job: str) -> None:
        self._names = experiment, job
        self._series: PrometheusSeries | None = None
        self._progress: JobProgress | None = None
        self._last = 0.0
        self._spent = _SpentTime()

    def joined(self, dashboard_url: str, num_cpus: int, log_folder: Path) -> None:
        """Make the series, which needs a Ray."""
        from jobs.progress.prometheus_series import PrometheusSeries

        self._series = PrometheusSeries(*self._names)

    def planned(self, progress: JobProgress) -> None:
        """Report what is to be done."""
        self._progress = progress
        self._report()

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        """Report now and then."""
        if isinstance(event, ShardProgress):
            self._spent.take_in(shard, event)
        if time.monotonic() - self._last >= _PAUSE_SECONDS:
            self._report()

    def ended(self, ending: Ending) -> None:
        """Report the end."""
        self._report()

    def _report(self) -> None:
        if self._series is None or self._progress is None:
            return
        self._last = time.monotonic()
        for name, arm in self._progress.arms().items():
            self._report_arm(self._series, name, arm)
        self._series.raise_to("apel_restarts_total", self._progress.num_restarts)

    def _report_arm(self, series: PrometheusSeries, name: str, arm: ArmProgress) -> None:
        for counter in ("episodes", "steps"):
            series.raise_to(f"apel_{counter}_total", getattr(arm, counter), name)
        for counter, total in self._spent.totals[name].items():
            series.raise_to(f"apel_{counter}_total", total, name)
        for gauge in ("runs_planned", "runs_done", "runs_failed", "mean_return", "mean_train_time"):
            value = getattr(arm, gauge)
            if value is not None:
                series.set(f"apel_{gauge}", value, arm=name)
        for learner, share in arm.selection_share.items():
            series.set("apel_selection_share", share, arm=name, learner=learner)
        for learner, concentration in arm.concentration.items():
            series.set("apel_concentration", concentration, arm=name, learner=learner)


class _SpentTime:
    """Rounds and seconds over all processes that ever played an arm's shards: theirs begin anew when they do."""

    def __init__(self) -> None:
        self.totals: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
        self._last: dict[tuple[tuple[str, str, int], str], float] = {}

    def take_in(self, shard: Shard, event: ShardProgress) -> None:
        for name in ("rounds", "round_seconds", "checkpoint_seconds"):
            value, key = float(getattr(event, name)), (shard.key, name)
            before = self._last.get(key, 0.0)
            self._last[key] = value
            self.totals[shard.arm.arm][name] += value - before if value >= before else value
