"""Runs an experiment from its plan to its stored results; resumes where an earlier session stopped."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal

import pyarrow as pa

from cluster.errors import RunFailure
from cluster.events import ShardDone, ShardEvent
from cluster.local import compile_for, not_compiled, run_shards
from cluster.shard import Execution, Shard
from cluster.storage_faults import StorageAwayError, StorageError
from jobs.lease import BusyError, Lease, lease, this_owner
from jobs.manifest import add_session, new_manifest
from jobs.observers import NO_OBSERVER, Ending, Observer
from jobs.plan import RunKey, all_run_keys, arm_points, plan_shards
from jobs.progress import JobProgress
from jobs.spec import Experiment
from jobs.store import CheckpointFiles, ParquetSink, ResultStore, StoreError
from jobs.validation import check

Placement = Literal["actors", "packed", "local"]
Stopping = Callable[[], bool]


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
    job:
        Id of the submitted job that this process is; empty for none.
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
    job: str = ""


@dataclass
class Outcome:
    """What came of it."""

    store: ResultStore
    summary: pa.Table
    failures: list[RunFailure] = field(default_factory=list)
    num_computed: int = 0
    """Runs computed in this session."""
    num_restarts: int = 0
    """How often a shard had to begin again since its processes had died."""
    seconds: float = 0.0
    """From the first shard to the last row, the cluster's start apart."""
    was_stopped: bool = False
    """Whether it was asked to stop before all was done."""


def run_experiment(
    experiment: Experiment,
    settings: Settings,
    observer: Observer = NO_OBSERVER,
    stopping: Stopping = lambda: False,
) -> Outcome:
    """Compute all runs that are missing, and make the summary.

    Once ``stopping()`` is true, the shards under way write checkpoints, and what is finished is summarised. An
    exception that interrupts it leaves every finished shard stored, and the others at their last checkpoint.

    Raises
    ------
    SpecError
        If the experiment cannot be built; before anything is started or written.
    StoreError
        If the results cannot be written.
    BusyError
        If another job is computing them.
    ClusterError
        If the cluster cannot be reached, or loses a shard too often.
    """
    check(experiment, settings.arms)
    store = ResultStore.of(experiment, settings.results)
    outcome = Outcome(store, pa.table({}))
    ending: Ending = "broken"
    with _held(store, settings.job, observer) as held:
        try:
            _work(experiment, settings, store, observer, outcome, lambda: stopping() or held.is_lost)
            if held.is_lost:
                message = f"{store.folder.location()}: another job has taken these results over; this one has ended"
                raise BusyError(message)
            ending = "stopped" if outcome.was_stopped else "failed" if outcome.failures else "done"
        finally:
            observer.ended(ending)
    return outcome


@contextmanager
def _held(store: ResultStore, job: str, observer: Observer) -> Iterator[Lease]:
    with ExitStack() as stack:
        try:
            held = stack.enter_context(lease(store.folder, this_owner(job), observer.waiting))
        except StorageAwayError:
            raise  # no fault of the place that was named
        except OSError as error:
            message = f"found a results folder that cannot be written to: {error}"
            raise StoreError(message) from error
        yield held


def _work(
    experiment: Experiment,
    settings: Settings,
    store: ResultStore,
    observer: Observer,
    outcome: Outcome,
    stopping: Stopping,
) -> None:
    store.open_for_writing(experiment, fresh=settings.fresh)
    finished = store.finished()
    if _is_complete(experiment, settings.arms, finished):
        progress = JobProgress()
        progress.planned([], finished)
        observer.planned(progress)
        _summarise(experiment, store, outcome)
        return
    # What is finished can be read like any result.
    with _afterwards(lambda: _summarise(experiment, store, outcome)):
        _compute(experiment, settings, store, finished, observer, outcome, stopping)


@contextmanager
def _afterwards(act: Callable[[], None]) -> Iterator[None]:
    """Act at the end, also of a body that was interrupted or broke off; but not where it is the storage that is away:
    each vain attempt would take as long as a job is patient with it, and end in another message.
    """
    try:
        yield
    except StorageError:
        raise
    except BaseException:
        act()
        raise
    act()


def _summarise(experiment: Experiment, store: ResultStore, outcome: Outcome) -> None:
    if store.finished():
        # With scipy's statistics, which take half a second to import: longer than most commands.
        from jobs.analysis.statistics import summarise

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
    stopping: Stopping,
) -> None:
    arms = [point.experiment.arms[arm] for point, arm in arm_points(experiment, settings.arms)]
    selectors = {"fixed", *(spec.selector.type for spec in arms if spec.selector)}
    if not_compiled(selectors):
        observer.compiling()
        compile_for(selectors)
    clock, progress = _ArmClock(), JobProgress()
    with _player(experiment, settings, store, observer, stopping) as (num_cpus, play):
        shards = plan_shards(experiment, settings.shard_size, settings.arms, finished, num_cpus)
        progress.planned(shards, finished)
        observer.planned(progress)
        began, started = datetime.now(UTC), time.monotonic()

        def keep_accounts() -> None:
            manifest = store.manifest() or new_manifest(experiment)
            session = (began, outcome.seconds, settings.placement, num_cpus, clock.arms)
            store.write_manifest(add_session(manifest, experiment, *session))

        with _afterwards(keep_accounts):
            try:
                for shard, event in play(shards):
                    progress.progressed(shard, event)
                    observer.progressed(shard, event, progress)
                    if isinstance(event, ShardDone):
                        clock.add(shard, event)
                        outcome.failures += event.failures
                        outcome.num_computed += len(shard.runs) - len(event.failures)
                outcome.was_stopped = clock.num_shards < len(shards)
            finally:
                outcome.seconds = time.monotonic() - started
                outcome.num_restarts = progress.num_restarts


@contextmanager
def _player(
    experiment: Experiment, settings: Settings, store: ResultStore, observer: Observer, stopping: Stopping
) -> Iterator[tuple[int, Callable[[Sequence[Shard]], Iterator[tuple[Shard, ShardEvent]]]]]:
    """Something that plays shards, and how many CPUs it has."""
    sink, checkpoints = ParquetSink(store.folder), CheckpointFiles(store.folder)
    if settings.placement == "local":
        yield 1, lambda shards: run_shards(shards, sink, checkpoints, settings.execution, stopping)
        return
    # Ray is imported only where it is used: a bad experiment file is refused in a fraction of its import time.
    from cluster.launch import ray_cluster
    from cluster.pool import ShardPool

    with ray_cluster(settings.address, settings.num_cpus, dashboard=settings.dashboard) as info:
        observer.joined(info.dashboard_url, info.num_cpus, info.log_folder)
        pool = ShardPool(experiment.name, settings.placement, sink, checkpoints, settings.execution)
        yield info.num_cpus, lambda shards: pool.run(shards, stopping)


class _ArmClock:
    """Wall time and steps of each arm, from the ends of its shards."""

    def __init__(self) -> None:
        self.arms: dict[str, dict[str, float]] = {}
        self.num_shards = 0
        self._spans: dict[str, tuple[float, float]] = {}

    def add(self, shard: Shard, done: ShardDone) -> None:
        self.num_shards += 1
        now = time.monotonic()
        first, _ = self._spans.get(shard.arm.arm, (now - done.seconds, now))
        first = min(first, now - done.seconds)
        self._spans[shard.arm.arm] = first, now
        entry = self.arms.setdefault(shard.arm.arm, {"steps": 0, "rounds": 0})
        entry["steps"] += done.steps
        entry["rounds"] += done.rounds
        entry["seconds"] = now - first
