"""The command line, ``apel``. Exit codes: 0 done; 1 a run failed; 2 bad input; 130 interrupted."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn, get_args

import typer
from rich.console import Console
from rich.table import Table

from cluster.checkpoint import CheckpointError
from cluster.errors import ClusterError, grouped
from cluster.shard import Execution
from jobs import reproduction, result_commands
from jobs.analysis.report import write_report
from jobs.event_files import EventFiles
from jobs.lease import BusyError
from jobs.metrics import MetricsObserver
from jobs.observers import Observer, Observers
from jobs.plan import arm_points
from jobs.remote import commands as job_commands
from jobs.result_commands import draw, write_and_show_reproduction
from jobs.runner import Outcome, Placement, Settings, run_experiment
from jobs.spec import Experiment
from jobs.spec_files import Group, load_experiment, shipped_experiments, shipped_galleries, shortcuts
from jobs.status_file import StatusFile
from jobs.stopping import stop_on_signals
from jobs.store import ResultStore, StoreError
from jobs.terminal import TerminalObserver, summary_table
from jobs.validation import check
from jobs.yaml_source import SpecError

app = typer.Typer(
    help="Ensembles of different reinforcement learners, over a hundred seeds, on Ray.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
job_commands.add_to(app)
result_commands.add_to(app)
# Wide enough for the table where the output goes to a file or to a job's log.
_out = Console(soft_wrap=True, width=None if sys.stdout.isatty() else 120)
_err = Console(stderr=True, soft_wrap=True)

_Reference = Annotated[
    str, typer.Argument(metavar="SPEC|NAME", help="An experiment file, or the name of a shipped one.")
]
_Set = Annotated[list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Override any field of the spec.")]
_Results = Annotated[
    str | None,
    typer.Option(envvar="APEL_RESULTS", help="Folder or URI for the results.", show_default="results"),
]


class InterruptedJobError(Exception):
    """The user has stopped a job."""


def main() -> None:
    """Entry point."""
    # A user's own learners, environments and metrics are found where the command is run.
    sys.path.insert(0, str(Path.cwd()))
    signal.signal(signal.SIGTERM, _interrupt)
    with _exit_codes():
        app(prog_name="apel")


@app.command("list")
def list_experiments() -> None:
    """Show the experiments that are shipped."""
    table = Table("name", "figures", "arms", "runs", "at most", "what")
    for name in shipped_experiments():
        experiment = load_experiment(name)
        arms = len(experiment.arms)
        points = arm_points(experiment, None)
        episodes = experiment.runs * sum(point.experiment.episodes for point, _ in points)
        table.add_row(
            name,
            ", ".join(experiment.figures),
            str(arms),
            str(experiment.runs),
            f"{episodes / 1e6:,.1f} M episodes",
            experiment.title,
        )
    for name, gallery in shipped_galleries().items():
        table.add_row(name, ", ".join(gallery.figures), "-", "-", "-", f"{gallery.title} (apel figures {name})")
    _out.print(table)


@app.command()
def validate(spec: _Reference, overrides: _Set = None) -> None:
    """Check an experiment: everything that it names is built once."""
    experiment = load_experiment(spec, overrides or [])
    check(experiment)
    arms = ", ".join(experiment.arms)
    _out.print(
        f"{experiment.name} ({experiment.identity}) is valid: arms {arms}; {experiment.runs} runs", highlight=False
    )


@app.command()
def run(
    spec: _Reference,
    runs: Annotated[int | None, typer.Option(help="Number of runs.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed from which all runs' seeds follow.")] = None,
    arms: Annotated[str | None, typer.Option(help="Only these arms, separated by commas.")] = None,
    placement: Annotated[str, typer.Option(help="actors, packed or local.")] = "actors",
    shard_size: Annotated[int | None, typer.Option(min=1, help="Runs that are played side by side.")] = None,
    address: Annotated[
        str | None, typer.Option(help="A Ray cluster: auto or HOST:PORT. Default: start one here; in a job, its own.")
    ] = None,
    cpus: Annotated[int | None, typer.Option(min=1, help="CPUs of the Ray that is started here.")] = None,
    results: _Results = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Start over.")] = False,
    overrides: _Set = None,
    checkpoint_seconds: Annotated[
        float, typer.Option(min=0.0, help="Time between checkpoints; they never take more than 5 % of it.")
    ] = Execution.checkpoint_seconds,
    checkpoint_episodes: Annotated[
        int | None, typer.Option(min=1, help="A checkpoint also after so many episodes of a shard.")
    ] = None,
    tensorboard: Annotated[str | None, typer.Option(metavar="DIR", help="Write TensorBoard event files.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, no table.")] = False,
) -> None:
    """Run an experiment, or go on where it stopped."""
    job = job_commands.current_job()
    settings = Settings(
        results=job_commands.results_root(results, job),
        arms=tuple(arms.split(",")) if arms else None,
        placement=_placement(placement),
        shard_size=shard_size,
        address=address or ("auto" if job else None),
        num_cpus=cpus,
        fresh=fresh,
        execution=Execution(checkpoint_seconds=checkpoint_seconds, checkpoint_episodes=checkpoint_episodes),
        job=job,
    )
    experiment = load_experiment(spec, [*shortcuts(runs, seed), *(overrides or [])])
    observers: list[Observer] = [] if quiet else [TerminalObserver(_out)]
    observers += [MetricsObserver(experiment.name, job)]
    observers += [_status_file(experiment, settings)] if job else []
    observers += [EventFiles(tensorboard)] if tensorboard else []
    with _graceful_stop() as stopping:
        outcome = run_experiment(experiment, settings, Observers(observers), stopping)
    _finish(experiment, outcome, quiet=quiet)
    if outcome.was_stopped:
        raise InterruptedJobError


@app.command()
def reproduce(
    scale: Annotated[str, typer.Option(help="smoke (2 runs each), tenth or full.")] = "full",
    group: Annotated[str, typer.Option(help="tabular, deep (hours on two cores) or cluster.")] = "tabular",
    results: _Results = None,
    placement: Annotated[str, typer.Option(help="actors, packed or local.")] = "packed",
    address: Annotated[str | None, typer.Option(help="A Ray cluster: auto or HOST:PORT.")] = None,
    cpus: Annotated[int | None, typer.Option(min=1, help="CPUs of the Ray that is started here.")] = None,
) -> None:
    """Run all experiments of a group, or go on where that stopped; then figures, claims, and one report of it all."""
    if scale not in ("smoke", "tenth", "full"):
        message = f"--scale: found {scale!r}, expected smoke, tenth or full"
        raise SpecError(message)
    if group not in get_args(Group):
        message = f"--group: found {group!r}, expected {', '.join(get_args(Group))}"
        raise SpecError(message)
    job = job_commands.current_job()
    results = job_commands.results_root(results, job)
    address = address or ("auto" if job else None)
    settings = Settings(results=results, placement=_placement(placement), address=address, num_cpus=cpus, job=job)

    def observer_for(experiment: Experiment) -> Observer:
        _out.print(f"{experiment.name}: {experiment.title}", highlight=False)
        more = [_status_file(experiment, settings)] if job else []
        return Observers([TerminalObserver(_out), MetricsObserver(experiment.name, job), *more])

    failed = False
    stores: list[ResultStore] = []
    with _graceful_stop() as stopping:
        for experiment, outcome in reproduction.reproduce(scale, group, settings, observer_for, stopping):  # type: ignore[arg-type]
            _out.print(f"{experiment.name}: {outcome.num_computed} runs in {outcome.seconds:.1f} s", highlight=False)
            stores.append(outcome.store)
            failed |= bool(outcome.failures)
            for line in grouped(outcome.failures):
                _err.print(f"error: {line}", style="red", highlight=False, markup=False)
            if outcome.was_stopped:
                raise InterruptedJobError
    write_and_show_reproduction(results, stores, group)  # type: ignore[arg-type]
    if failed:
        raise typer.Exit(1)


def _finish(experiment: Experiment, outcome: Outcome, *, quiet: bool) -> None:
    store = outcome.store
    pages = [*draw(store, experiment), write_report(store)] if len(outcome.summary) else []
    if not quiet and pages:
        if not outcome.num_computed and not outcome.failures:
            _out.print(
                f"complete: {experiment.name} ({experiment.identity}) has all its runs; --fresh starts over",
                highlight=False,
            )
        _out.print(summary_table(outcome.summary, store.manifest()))
        if outcome.num_computed:
            _out.print(f"{outcome.num_computed} runs in {outcome.seconds:.1f} s, Ray's start apart", highlight=False)
        for name in ("runs.parquet", "summary.parquet", "episodes/"):
            _out.print(store.folder.location(name), highlight=False)
        for path in pages:
            _out.print(path, highlight=False)
    if outcome.failures:
        for line in grouped(outcome.failures):
            _err.print(f"error: {line}", style="red", highlight=False, markup=False)
        raise typer.Exit(1)


@contextmanager
def _graceful_stop() -> Iterator[Callable[[], bool]]:
    """The first signal lets shards write checkpoints, a second one ends everything at once."""

    def say() -> None:
        _err.print("stopping: shards under way write checkpoints; once more to end at once", highlight=False)

    try:
        with stop_on_signals(say) as stopping:
            yield stopping
    except KeyboardInterrupt:
        raise InterruptedJobError from None  # typer would answer for it, and say nothing


def _status_file(experiment: Experiment, settings: Settings) -> StatusFile:
    location = ResultStore.of(experiment, settings.results).folder.location()
    about = {"experiment": experiment.name, "identity": experiment.identity, "results": location}
    return StatusFile(settings.job, about)


def _placement(name: str) -> Placement:
    if name not in ("actors", "packed", "local"):
        message = f"--placement: found {name!r}, expected actors, packed or local"
        raise SpecError(message)
    return name  # type: ignore[return-value]


@contextmanager
def _exit_codes() -> Iterator[None]:
    """Expected errors become one message and an exit code; anything else is a bug and keeps its traceback."""
    try:
        yield
    except (SpecError, StoreError, BusyError) as error:
        _fail(str(error), 2)
    except (ClusterError, CheckpointError, OSError) as error:
        _fail(str(error), 1)
    except (KeyboardInterrupt, InterruptedJobError):
        _fail("interrupted; what is finished is stored, and the same command goes on from here", 130)


def _fail(message: str, code: int) -> NoReturn:
    for line in message.splitlines():
        _err.print(f"error: {line}", style="red", highlight=False, markup=False)
    raise SystemExit(code)


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt
