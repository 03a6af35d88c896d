"""The commands that compute: run, reproduce."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, get_args

import typer

from apel.numerics.near_names import did_you_mean
from cluster.errors import grouped
from jobs.analysis.answer import DEFAULT_ERROR
from jobs.cli.consoles import ERR, OUT, print_error, print_note
from jobs.cli.option_groups import with_option_groups
from jobs.cli.result_commands import draw, write_and_show_reproduction
from jobs.cli.run_options import ExperimentOptions, HereOptions, RunOptions
from jobs.cli.stopping import InterruptedJobError, stop_on_signals
from jobs.cli.this_job import current_job
from jobs.cli.user_modules import find_user_modules
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_files import Group
from jobs.experiment.yaml_source import SpecError
from jobs.progress.apart import Apart
from jobs.progress.job_observer import JobInfo
from jobs.progress.loggers import observer_of
from jobs.progress.observers import Observer, Observers
from jobs.progress.prometheus import PrometheusObserver
from jobs.progress.status_file import StatusFile
from jobs.progress.terminal import NoteObserver, TerminalObserver, summary_table
from jobs.reproduction.run_all import Scale
from jobs.reproduction.run_all import reproduce as reproduce_all
from jobs.results.failures import FAILURES
from jobs.results.store import ResultStore
from jobs.runner import Outcome, Settings, run_experiment


def add_to(app: typer.Typer) -> None:
    """Add the commands to the program."""
    commands: tuple[Callable[..., None], ...] = (run, reproduce)
    for function in commands:
        app.command(function.__name__)(with_option_groups(function))


def run(
    which: ExperimentOptions,
    options: RunOptions,
    here: HereOptions,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print neither progress nor tables.")] = False,
    stop_in_debugger: Annotated[
        bool,
        typer.Option("--debug", help="Play runs in this process until one fails, and open Python's debugger there."),
    ] = False,
) -> None:
    """Run an experiment, or resume it where it stopped."""
    settings = options.settings(here, current_job())
    experiment = which.load(options.max_runs)
    find_user_modules()
    if stop_in_debugger:
        if options.log:
            message = f"--log: found {options.log[0]!r} with --debug, which tells nobody, expected one of the two"
            raise SpecError(message)
        from jobs.cli.debugging import debug

        debug(experiment, settings)
        return
    observers: list[Observer] = [NoteObserver(ERR), *([] if quiet else [TerminalObserver(OUT)])]
    observers += [*_reporting(experiment, settings), *_logging(experiment, settings, options.log or [])]
    with _graceful_stop() as stopping:
        outcome = run_experiment(experiment, settings, Observers(observers), stopping)
    _finish(experiment, outcome, settings, quiet=quiet)
    if outcome.was_stopped:
        raise InterruptedJobError


def reproduce(
    *,
    scale: Annotated[str, typer.Option(help="smoke (2 runs each), tenth or full.")] = "full",
    group: Annotated[str, typer.Option(help="tabular, deep (hours on two cores) or cluster.")] = "tabular",
    placement: Annotated[str, typer.Option(help="actors, packed or local.")] = "packed",
    here: HereOptions,
) -> None:
    """Run or resume all experiments of a group, then draw the figures, check the claims, and write one report."""
    _expect("--scale", scale, get_args(Scale), "smoke, tenth or full")
    _expect("--group", group, get_args(Group), ", ".join(get_args(Group)))
    settings = RunOptions(placement=placement).settings(here, current_job())

    def observer_for(experiment: Experiment) -> Observer:
        OUT.print(f"{experiment.name}: {experiment.title}", highlight=False)
        return Observers([NoteObserver(ERR), TerminalObserver(OUT), *_reporting(experiment, settings)])

    failed = False
    stores: list[ResultStore] = []
    with _graceful_stop() as stopping:
        for experiment, outcome in reproduce_all(scale, group, settings, observer_for, stopping):  # type: ignore[arg-type]
            OUT.print(f"{experiment.name}: {outcome.num_computed} runs in {outcome.seconds:.1f} s", highlight=False)
            stores.append(outcome.store)
            failed |= bool(outcome.failures)
            _tell_failures(outcome)
            if outcome.was_stopped:
                raise InterruptedJobError
    write_and_show_reproduction(settings.results, stores, group)  # type: ignore[arg-type]
    if failed:
        raise typer.Exit(1)


def _expect(option: str, found: str, known: tuple[str, ...], expected: str) -> None:
    if found not in known:
        message = f"{option}: found {found!r}, expected {expected}{did_you_mean(found, known)}"
        raise SpecError(message)


def _reporting(experiment: Experiment, settings: Settings) -> list[Observer]:
    """Those who tell the cluster how the job goes on."""
    observers: list[Observer] = [PrometheusObserver(experiment.name, settings.job)]
    if settings.job:
        location = ResultStore.of(experiment, settings.results).folder.location()
        about = {"experiment": experiment.name, "identity": experiment.identity, "results": location}
        observers.append(StatusFile(settings.job, about))
    return observers


def _logging(experiment: Experiment, settings: Settings, logs: list[str]) -> list[Observer]:
    """Those of ``--log``; every one of them is there before anything is started."""
    if not logs:
        return []
    location = ResultStore.of(experiment, settings.results).folder.location()
    job = JobInfo(experiment.name, experiment.identity, location, settings.job, experiment.content())
    return [Apart(log, observer_of(log, job), job, print_note) for log in logs]


def _finish(experiment: Experiment, outcome: Outcome, settings: Settings, *, quiet: bool) -> None:
    store = outcome.store
    pages: list[str] = []
    answer: list[str] = []
    if len(outcome.summary):
        # With scipy's statistics, which take half a second to import.
        from jobs.analysis.answer.comparison import compare
        from jobs.analysis.answer.words import answer_lines
        from jobs.analysis.pages.report import write_report

        # Of the arms that were asked for, as --until decided has it: others may have been played before.
        answer = answer_lines(compare(store, settings.error or DEFAULT_ERROR, settings.arms))
        pages = [*draw(store, experiment), write_report(store, answer)]
    if not quiet and pages:
        if not outcome.num_computed and not outcome.failures and not outcome.told:
            OUT.print(
                f"complete: {experiment.name} ({experiment.identity}) has all its runs; --fresh starts over",
                highlight=False,
            )
        OUT.print(summary_table(outcome.summary, store.manifest()))
        if outcome.num_computed:
            runs = "1 run" if outcome.num_computed == 1 else f"{outcome.num_computed} runs"
            OUT.print(f"{runs} in {outcome.seconds:.1f} s, without Ray's start", highlight=False)
        for name in ("runs.parquet", "summary.parquet", "episodes/"):
            OUT.print(store.folder.location(name), highlight=False)
        for path in pages:
            OUT.print(path, highlight=False)
        for line in ("", *([outcome.told] if outcome.told else []), *answer):
            OUT.print(line, highlight=False)
    if outcome.failures:
        _tell_failures(outcome)
        raise typer.Exit(1)


def _tell_failures(outcome: Outcome) -> None:
    for line in grouped(outcome.failures):
        print_error(line)
    if any(failure.trace for failure in outcome.failures):
        print_error(f"full tracebacks: {outcome.store.folder.location(FAILURES)}; --debug stops at the first of them")


@contextmanager
def _graceful_stop() -> Iterator[Callable[[], bool]]:
    """The first signal lets shards write checkpoints, a second one ends everything at once."""

    def say() -> None:
        ERR.print("stopping: running shards write checkpoints; interrupt again to stop at once", highlight=False)

    try:
        with stop_on_signals(say) as stopping:
            yield stopping
    except KeyboardInterrupt:
        raise InterruptedJobError from None  # typer would answer for it, and say nothing
