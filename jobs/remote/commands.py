"""The commands that deal with jobs on a cluster: submit, jobs, status, logs, stop, resume, fetch.

What they do is in `jobs.remote.submission`, which is imported when one of them is called: it takes Ray.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from jobs.remote import DEFAULT_ADDRESS
from jobs.remote.package import refuse_credentials
from jobs.spec_files import load_experiment, shortcuts
from jobs.stopping import stop_on_signals
from jobs.validation import check

if TYPE_CHECKING:
    from jobs.remote.submission import Job

_out = Console(soft_wrap=True, width=None if sys.stdout.isatty() else 120)

_Job = Annotated[str, typer.Argument(metavar="JOB", help="The id of a job, as `apel submit` and `apel jobs` print it.")]
_Address = Annotated[
    str,
    typer.Option(envvar="RAY_API_SERVER_ADDRESS", metavar="URL", help="Of the cluster's dashboard."),
]
_Follow = Annotated[bool, typer.Option("--follow", help="Go on until the job ends.")]


def add_to(app: typer.Typer) -> None:
    """Add the commands to the program."""
    commands: dict[str, Callable[..., None]] = {
        "submit": submit, "jobs": jobs, "status": status, "logs": logs, "stop": stop, "resume": resume, "fetch": fetch,
    }  # fmt: skip
    for name, function in commands.items():
        app.command(name)(function)
    app.command("pack", hidden=True)(pack)


def submit(
    spec: Annotated[str, typer.Argument(metavar="SPEC|NAME", help="An experiment file, or the name of a shipped one.")],
    address: _Address = DEFAULT_ADDRESS,
    runs: Annotated[int | None, typer.Option(help="Number of runs.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed from which all runs' seeds follow.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Override any field of the spec.")
    ] = None,
    results: Annotated[
        str | None,
        typer.Option(help="Path on the cluster's nodes, or URI. Default: APEL_RESULTS there, else ~/apel-results."),
    ] = None,
    arms: Annotated[str | None, typer.Option(help="Only these arms, separated by commas.")] = None,
    placement: Annotated[str | None, typer.Option(help="actors, packed or local.")] = None,
    shard_size: Annotated[int | None, typer.Option(min=1, help="Runs that are played side by side.")] = None,
    checkpoint_seconds: Annotated[float | None, typer.Option(min=0.0, help="Time between checkpoints.")] = None,
    module: Annotated[
        list[str] | None, typer.Option(help="A module of this folder to be sent too, though nothing names it.")
    ] = None,
    follow: _Follow = False,
) -> None:
    """Run an experiment as a job on a cluster; the spec, and the modules of yours that it names, are sent along."""
    from jobs.remote import submission

    experiment = load_experiment(spec, [*shortcuts(runs, seed), *(overrides or [])])
    check(experiment, arms.split(",") if arms else None)
    given = {"arms": arms, "placement": placement, "shard-size": shard_size, "checkpoint-seconds": checkpoint_seconds}
    options = [word for name, value in given.items() if value is not None for word in (f"--{name}", str(value))]
    job = submission.submit(experiment, address=address, options=options, results=results, modules=module or [])
    if job.was_running:
        _out.print(f"{job.id} is at work on this already", highlight=False)
    else:
        _out.print(job.id, highlight=False)
    if follow:
        _follow(job)


def jobs(address: _Address = DEFAULT_ADDRESS) -> None:
    """Show the jobs of this program on a cluster, the latest first."""
    from jobs.remote import submission

    table = Table(box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0))
    for heading in ("job", "state", "runs", "of", "steps/s", "time"):
        table.add_column(heading, justify="left" if heading in ("job", "state") else "right", no_wrap=True)
    for one in submission.list_jobs(address):
        table.add_row(one.job, one.state, *_totals(one.progress))
    _out.print(table)


def status(
    job: _Job,
    address: _Address = DEFAULT_ADDRESS,
    as_json: Annotated[bool, typer.Option("--json", help="All of it, for programs.")] = False,
) -> None:
    """Show how far a job has come, arm by arm, as it says itself."""
    from jobs.remote.submission import Job

    found = Job(job, address).status()
    if as_json:
        _out.print_json(json.dumps(asdict(found)))
        return
    _out.print(f"{found.job}: {found.state}", highlight=False)
    if found.message:
        _out.print(found.message, highlight=False, markup=False)
    if found.progress is not None:
        _out.print(_arms_table(found.progress))
        _out.print(f"results: {found.progress['results']}", highlight=False)


def logs(job: _Job, address: _Address = DEFAULT_ADDRESS, follow: _Follow = False) -> None:
    """Show what a job has printed."""
    from jobs.remote.submission import Job

    if follow:
        _follow(Job(job, address))
    else:
        sys.stdout.write(Job(job, address).logs())


def stop(job: _Job, address: _Address = DEFAULT_ADDRESS) -> None:
    """Let a job write checkpoints and end; `apel resume` lets it go on."""
    from jobs.remote.submission import Job

    found = Job(job, address).stop()
    done, planned, *_ = _totals(found.progress)
    _out.print(f"{job}: {found.state}, {done} of {planned} runs are finished", highlight=False)


def resume(job: _Job, address: _Address = DEFAULT_ADDRESS, follow: _Follow = False) -> None:
    """Submit a job of this machine again: it goes on where it stopped, also on a cluster that has forgotten it."""
    from jobs.remote.submission import Job

    resumed = Job(job, address).resume()
    _out.print(f"{resumed.id} is at work on this already" if resumed.was_running else resumed.id, highlight=False)
    if follow:
        _follow(resumed)


def fetch(
    job: _Job,
    destination: Annotated[Path, typer.Argument(metavar="DEST", help="A folder on this machine.")],
    address: _Address = DEFAULT_ADDRESS,
) -> None:
    """Copy a job's results, as far as they are there, into a folder on this machine."""
    from jobs.remote.submission import Job

    _out.print(str(Job(job, address).fetch(destination)), highlight=False)


def pack(results: str) -> None:
    """Pack results where the dashboard can serve them: the cluster's part of `apel fetch`."""
    from cluster.launch import ray_cluster
    from jobs.remote.packing import serve_archive

    with ray_cluster("auto") as info, stop_on_signals(lambda: None) as stopping:
        serve_archive(results, current_job(), info.log_folder, stopping)


def current_job() -> str:
    """The id of the submitted job that this process is the driver of; empty for none."""
    with suppress(ValueError):
        config = json.loads(os.environ.get("RAY_JOB_CONFIG_JSON_ENV_VAR", "{}"))
        return str(config.get("metadata", {}).get("job_submission_id", ""))
    return ""


def results_root(given: str | None, job: str) -> str:
    """Where results go; if nobody says, beside the user's files, but not into a job's folder, which Ray deletes.

    Raises
    ------
    SpecError
        If it holds a secret.
    """
    if given is None:
        return str(Path.home() / "apel-results") if job else "results"
    refuse_credentials(given)
    return given


def _follow(job: Job) -> None:
    for piece in job.follow():
        sys.stdout.write(piece)
        sys.stdout.flush()
    ended = job.wait()
    if ended.state != "done":
        raise typer.Exit(ended.exit_code or 1)


def _totals(progress: dict[str, Any] | None) -> tuple[str, str, str, str]:
    """Runs done, runs planned, steps per second and time, of a job."""
    if progress is None:
        return "-", "-", "-", "-"
    arms = progress["arms"].values()
    steps = sum(arm["steps"] for arm in arms) / max(progress["seconds"], 1e-9) / 1e6
    done, planned = (sum(arm[name] for arm in arms) for name in ("runs_done", "runs_planned"))
    return str(done), str(planned), f"{steps:,.1f} M", f"{progress['seconds']:,.0f} s"


def _arms_table(progress: dict[str, Any]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0))
    for heading in ("arm", "runs", "failed", "episodes", "steps", "mean return", "train time", "selected"):
        table.add_column(heading, justify="left" if heading in ("arm", "selected") else "right", no_wrap=True)
    for name, arm in progress["arms"].items():
        share = arm["episodes"] / arm["episodes_planned"] if arm["episodes_planned"] else 1.0
        table.add_row(
            name,
            f"{arm['runs_done']} of {arm['runs_planned']}",
            str(arm["runs_failed"]),
            f"{share:.0%}".replace("%", " %"),
            f"{arm['steps'] / 1e6:,.1f} M",
            "-" if arm["mean_return"] is None else f"{arm['mean_return']:,.2f}",
            "-" if arm["mean_train_time"] is None else f"{arm['mean_train_time']:,.0f}",
            ", ".join(f"{learner} {part:.0%}" for learner, part in arm["selection_share"].items()).replace("%", " %"),
        )
    return table
