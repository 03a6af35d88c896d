"""Runs an experiment from its plan to its stored results; resumes where an earlier session stopped."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal, get_args

import pyarrow as pa

from cluster.compiling import compile_for, not_compiled
from cluster.errors import RunFailure
from cluster.events import ShardDone, ShardEvent
from cluster.local import run_shards
from cluster.shard import Execution, Shard
from jobs.experiment.plan import Plan, RunKey
from jobs.experiment.resumption import resumption_notes
from jobs.experiment.spec import Experiment
from jobs.experiment.validation import check
from jobs.precautions import of_this_machine, refuse_settings, refuse_shadowing
from jobs.progress.arm_clock import ArmClock
from jobs.progress.observers import NO_OBSERVER, Ending, Observer, told_if_it_lasts
from jobs.progress.progress import JobProgress
from jobs.results.caps import counted_with_cap
from jobs.results.failures import FailureFiles
from jobs.results.lease import BusyError, Lease, lease, this_owner
from jobs.results.manifest import add_session, new_manifest
from jobs.results.provenance import of_other_sources, of_other_versions
from jobs.results.sinks import begun_runs
from jobs.results.storage_faults import StorageAwayError, StorageError
from jobs.results.store import CheckpointFiles, ParquetSink, ResultStore, StoreError
from jobs.rounds import AllAtOnce, Rounds, UntilDecided, refuse_undecidable

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
    error:
        Add runs in rounds until the best arm is decided with this probability to be wrong, or all are there; None: play
        all of them. See `jobs.rounds.UntilDecided`.
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
    error: float | None = None

    def __post_init__(self) -> None:
        counts = {"shard_size": self.shard_size, "num_cpus": self.num_cpus}
        refuse_settings(self.placement, get_args(Placement), **counts)


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
    told: str = ""
    """Why not all runs were played, where they were added until something was decided."""


def run_experiment(
    experiment: Experiment,
    settings: Settings,
    observer: Observer = NO_OBSERVER,
    stopping: Stopping = lambda: False,
) -> Outcome:
    """Compute all runs of an experiment that are missing, and make the summary; see `run_planned`.

    Raises
    ------
    SpecError
        If a combination of swept values is not a valid experiment.
    """
    return run_planned(Plan.of(experiment), settings, observer, stopping)


def run_planned(
    plan: Plan,
    settings: Settings,
    observer: Observer = NO_OBSERVER,
    stopping: Stopping = lambda: False,
) -> Outcome:
    """Compute all runs of a plan (of all arms, of which the settings choose) that are missing, and make the summary.

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
    refuse_shadowing()
    if settings.error is not None:
        refuse_undecidable(plan.only(settings.arms), settings.error)
    check(plan, settings.arms)
    if settings.address is None:
        of_this_machine(plan.only(settings.arms), settings.placement, settings.num_cpus, observer.noted)
    store = ResultStore.of(plan.experiment, settings.results)
    outcome = Outcome(store, pa.table({}))
    ending: Ending = "broken"
    with _held(store, settings.job, observer) as held:
        try:
            _work(plan, settings, store, observer, outcome, lambda: stopping() or held.is_lost)
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
    plan: Plan,
    settings: Settings,
    store: ResultStore,
    observer: Observer,
    outcome: Outcome,
    stopping: Stopping,
) -> None:
    store.say = observer.noted
    for message in (
        *of_other_sources(plan.experiment, settings.results),
        *([] if settings.fresh else of_other_versions(plan.experiment, store.manifest())),
    ):
        observer.noted(message)
    store.open_for_writing(plan.experiment, fresh=settings.fresh)
    finished: Collection[RunKey] = store.finished(plan)
    rounds = _rounds(plan, settings, store)
    if rounds.next(finished) is None:
        progress = JobProgress()
        progress.planned([], finished)
        observer.planned(progress)
        _summarise(plan, store, outcome)
    else:
        # What is finished can be read like any result.
        with _afterwards(lambda: _summarise(plan, store, outcome)):
            finished = _compute(
                plan.only(settings.arms), rounds, settings, store, finished, observer, outcome, stopping
            )
    if not outcome.was_stopped and not outcome.failures:
        outcome.told = rounds.told(finished)


def _rounds(plan: Plan, settings: Settings, store: ResultStore) -> Rounds:
    wanted = plan.only(settings.arms)
    if settings.error is None:
        return AllAtOnce(wanted)
    return UntilDecided(wanted, settings.error, lambda: store.consolidate(plan))


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


def _summarise(plan: Plan, store: ResultStore, outcome: Outcome) -> None:
    if store.folder.names("parts"):
        # With scipy's statistics, which take half a second to import: longer than most commands.
        from jobs.analysis.statistics import summarise

        runs = counted_with_cap(store.consolidate(plan), plan.experiment)
        outcome.summary = summarise(runs)
        store.write_summary(outcome.summary, runs)


def _compute(
    plan: Plan,
    rounds: Rounds,
    settings: Settings,
    store: ResultStore,
    before: Collection[RunKey],
    observer: Observer,
    outcome: Outcome,
    stopping: Stopping,
) -> Collection[RunKey]:
    """Play what ``rounds`` say, round by round; returns the runs that are finished then."""
    if not_compiled(plan.compiled_parts):
        with told_if_it_lasts(observer.compiling):
            compile_for(plan.compiled_parts)
    notes = resumption_notes(plan)
    for note in notes:
        observer.noted(note)
    clock, progress = ArmClock(), JobProgress()
    FailureFiles(store.folder).forget()
    with _player(plan.experiment.name, settings, store, observer, stopping) as (num_cpus, play):
        began, started = datetime.now(UTC), time.monotonic()

        def keep_accounts() -> None:
            manifest = store.manifest() or new_manifest(plan.experiment)
            session = (began, outcome.seconds, settings.placement, num_cpus, clock.arms)
            store.write_manifest(add_session(manifest, plan, *session, notes))

        def play_round(due: Plan, finished: Collection[RunKey]) -> None:
            shards = due.shards(
                num_cpus=num_cpus,
                shard_size=settings.shard_size,
                finished=finished,
                begun=lambda arm, sweep: begun_runs(store.folder, arm, sweep),
            )
            progress.planned(shards, before)
            observer.planned(progress)
            _take_in(play(shards), outcome, FailureFiles(store.folder), clock, progress, observer)
            outcome.was_stopped = clock.num_shards < progress.num_shards

        with _afterwards(keep_accounts):
            try:
                finished = before
                while not (outcome.was_stopped or outcome.failures) and (due := rounds.next(finished)) is not None:
                    play_round(due, finished)
                    finished = {*finished, *due.run_keys()}
            finally:
                outcome.seconds = time.monotonic() - started
                outcome.num_restarts = progress.num_restarts
    return finished


def _take_in(
    events: Iterator[tuple[Shard, ShardEvent]],
    outcome: Outcome,
    files: FailureFiles,
    clock: ArmClock,
    progress: JobProgress,
    observer: Observer,
) -> None:
    """Tell everybody of what happens."""
    for shard, event in events:
        progress.progressed(shard, event)
        observer.progressed(shard, event, progress)
        if isinstance(event, ShardDone):
            clock.add(shard, event)
            outcome.failures += event.failures
            files.add(event.failures)
            outcome.num_computed += len(shard.runs) - len(event.failures)


@contextmanager
def _player(
    experiment: str, settings: Settings, store: ResultStore, observer: Observer, stopping: Stopping
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
        parts = experiment, settings.placement, sink, checkpoints, settings.execution
        yield info.num_cpus, lambda shards: ShardPool(*parts).run(shards, stopping)
