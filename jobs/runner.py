"""Runs an experiment from its plan to its stored results; resumes where an earlier session stopped."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal

import pyarrow as pa

from cluster.coordinator import ShardDone, ShardProgress
from cluster.errors import RunFailure
from cluster.local import compile_for, not_compiled, run_shards
from cluster.shard import Execution, Shard
from jobs.analysis.statistics import summarise
from jobs.manifest import add_session, new_manifest
from jobs.plan import RunKey, all_run_keys, plan_shards
from jobs.spec import Experiment
from jobs.store import CheckpointFiles, ParquetSink, ResultStore
from jobs.validation import check

Placement = Literal["actors", "packed", "local"]
Event = tuple[Shard, ShardProgress | ShardDone]


@dataclass(frozen=True)
class Settings:
    """How and where to run; none of it changes a result.

    Attributes
    ----------
    arms:
        Only these; None for all.
    placement:
        ``actors``: every learner and coordinator a Ray actor; ``packed``: a shard in one Ray actor; ``local``: no Ray.
    shard_size:
        Runs per shard; None chooses.
    address:
        Of a Ray cluster; None starts one on this machine.
    num_cpus:
        Of the Ray that is started; None for all that Ray finds, which heeds the limits of a container.
    fresh:
        Forget earlier results.
    """

    results: str = "results"
    arms: tuple[str, ...] | None = None
    placement: Placement = "actors"
    shard_size: int | None = None
    address: str | None = None
    num_cpus: int | None = None
    fresh: bool = False
    dashboard: bool = True
    execution: Execution = field(default_factory=Execution)


class Observer:
    """Told of what happens; this one does nothing."""

    def compiling(self) -> None:
        """Compiled functions are made, once per installation."""

    def joined(self, dashboard_url: str, num_cpus: int) -> None:
        """The cluster is there."""

    def planned(self, shards: Sequence[Shard], num_finished: int) -> None:
        """What is to be done, and how many runs were done before."""

    def progressed(self, shard: Shard, event: ShardProgress | ShardDone) -> None:
        """A shard went on."""


@dataclass
class Outcome:
    """What came of it."""

    store: ResultStore
    summary: pa.Table
    failures: list[RunFailure] = field(default_factory=list)
    num_computed: int = 0
    """Runs computed in this session."""
    seconds: float = 0.0
    """From the first shard to the last row, the cluster's start apart."""


def run_experiment(experiment: Experiment, settings: Settings, observer: Observer | None = None) -> Outcome:
    """Compute all runs that are missing, and make the summary.

    Interrupting it leaves every finished shard stored, and the others at their last checkpoint.

    Raises
    ------
    SpecError
        If the experiment cannot be built; before anything is started or written.
    StoreError
        If the results cannot be written.
    ClusterError
        If the cluster cannot be reached, or loses a shard too often.
    """
    observer = observer or Observer()
    check(experiment, settings.arms)
    store = ResultStore.of(experiment, settings.results)
    store.open_for_writing(experiment, fresh=settings.fresh)
    finished = store.finished()
    outcome = Outcome(store, pa.table({}))
    if _is_complete(experiment, settings.arms, finished):
        observer.planned([], len(finished))
        _summarise(experiment, store, outcome)
        return outcome
    try:
        _compute(experiment, settings, store, finished, observer, outcome)
    finally:
        # Also of a job that was interrupted or broke off: what is finished can be read like any result.
        _summarise(experiment, store, outcome)
    return outcome


def _summarise(experiment: Experiment, store: ResultStore, outcome: Outcome) -> None:
    if store.finished():
        outcome.summary = summarise(store.consolidate(experiment))
        store.write_table("summary.parquet", outcome.summary)


def _is_complete(experiment: Experiment, arms: Collection[str] | None, finished: Collection[RunKey]) -> bool:
    return all(key in finished for key in all_run_keys(experiment, arms))


def _compute(
    experiment: Experiment,
    settings: Settings,
    store: ResultStore,
    finished: Collection[RunKey],
    observer: Observer,
    outcome: Outcome,
) -> None:
    selectors = {spec.selector.type if spec.selector else "fixed" for spec in experiment.arms.values()}
    if not_compiled(selectors):
        observer.compiling()
        compile_for(selectors)
    clock = _ArmClock()
    with _player(experiment, settings, store, observer) as (num_cpus, play):
        shards = plan_shards(experiment, settings.shard_size, settings.arms, finished, num_cpus)
        observer.planned(shards, len(finished))
        began, started = datetime.now(UTC), time.monotonic()
        try:
            for shard, event in play(shards):
                observer.progressed(shard, event)
                if isinstance(event, ShardDone):
                    clock.add(shard, event)
                    outcome.failures += event.failures
                    outcome.num_computed += len(shard.runs) - len(event.failures)
        finally:
            outcome.seconds = time.monotonic() - started
            manifest = store.manifest() or new_manifest(experiment)
            store.write_manifest(
                add_session(manifest, experiment, began, outcome.seconds, settings.placement, num_cpus, clock.arms)
            )


@contextmanager
def _player(
    experiment: Experiment, settings: Settings, store: ResultStore, observer: Observer
) -> Iterator[tuple[int, Callable[[Sequence[Shard]], Iterator[Event]]]]:
    """Something that plays shards, and how many CPUs it has."""
    sink, checkpoints = ParquetSink(store.folder), CheckpointFiles(store.folder)
    if settings.placement == "local":
        yield 1, lambda shards: run_shards(shards, sink, checkpoints, settings.execution)
        return
    # Ray is imported only where it is used: a bad experiment file is refused in a fraction of its import time.
    from cluster.launch import ShardPool, ray_cluster

    with ray_cluster(settings.address, settings.num_cpus, dashboard=settings.dashboard) as info:
        observer.joined(info.dashboard_url, info.num_cpus)
        pool = ShardPool(experiment.name, settings.placement, sink, checkpoints, settings.execution)
        yield info.num_cpus, pool.run


class _ArmClock:
    """Wall time and steps of each arm, from the ends of its shards."""

    def __init__(self) -> None:
        self.arms: dict[str, dict[str, float]] = {}
        self._spans: dict[str, tuple[float, float]] = {}

    def add(self, shard: Shard, done: ShardDone) -> None:
        now = time.monotonic()
        first, _ = self._spans.get(shard.arm.arm, (now - done.seconds, now))
        first = min(first, now - done.seconds)
        self._spans[shard.arm.arm] = first, now
        entry = self.arms.setdefault(shard.arm.arm, {"steps": 0, "rounds": 0})
        entry["steps"] += done.steps
        entry["rounds"] += done.rounds
        entry["seconds"] = now - first
