"""The commands that deal with jobs on a cluster: submit, jobs, status, logs, stop, resume, fetch.

What they do is in `jobs.remote.job`, which is imported when one of them is called: it takes Ray.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from jobs.analysis.pages.escaping import printable_log
from jobs.cli.consoles import OUT, AsJson, print_for_programs
from jobs.cli.job_tables import arms_table, jobs_table, time_left, totals
from jobs.cli.option_groups import with_option_groups
from jobs.cli.run_options import ExperimentOptions, RunOptions
from jobs.cli.stopping import stop_on_signals
from jobs.cli.this_job import current_job
from jobs.cli.user_modules import find_user_modules
from jobs.experiment.plan import Plan
from jobs.experiment.validation import check
from jobs.remote import DEFAULT_ADDRESS
from jobs.rounds import refuse_undecidable

if TYPE_CHECKING:
    from jobs.remote.job import Job

_JobId = Annotated[
    str, typer.Argument(metavar="JOB", help="The id of a job, as `apel submit` and `apel jobs` print it.")
]
_Address = Annotated[
    str,
    typer.Option(envvar="RAY_API_SERVER_ADDRESS", metavar="URL", help="Address of the cluster's dashboard."),
]
_Follow = Annotated[bool, typer.Option("--follow", help="Keep following until the job ends.")]


def add_to(app: typer.Typer) -> None:
    """Add the commands to the program."""
    commands: tuple[Callable[..., None], ...] = (submit, jobs, status, logs, stop, resume, fetch)
    for function in commands:
        app.command(function.__name__)(with_option_groups(function))
    app.command("pack", hidden=True)(pack)


def submit(
    which: ExperimentOptions,
    options: RunOptions,
    address: _Address = DEFAULT_ADDRESS,
    results: Annotated[
        str | None,
        typer.Option(help="Path on the cluster's nodes, or URI. Default: APEL_RESULTS there, else ~/apel-results."),
    ] = None,
    module: Annotated[
        list[str] | None, typer.Option(help="Also send this module of this folder, though nothing names it.")
    ] = None,
    follow: _Follow = False,
) -> None:
    """Run an experiment as a job on a cluster. The spec and those of your modules that it names are sent along."""
    from jobs.remote.job import submit as submit_job

    experiment = which.load(options.max_runs)
    find_user_modules()
    plan = Plan.of(experiment)
    if options.until:
        refuse_undecidable(plan.only(options.chosen_arms), options.chosen_error)
    check(plan, options.chosen_arms)
    job = submit_job(
        experiment, address=address, options=options.words(), results=results, modules=module or [],
        needed=options.log_modules,
    )  # fmt: skip
    _say_submitted(job)
    if follow:
        _follow(job)


def jobs(address: _Address = DEFAULT_ADDRESS, as_json: AsJson = False) -> None:
    """List APEL's jobs on a cluster, latest first."""
    from jobs.remote.status import list_jobs

    found = list_jobs(address)
    if as_json:
        print_for_programs([asdict(one) for one in found])
    else:
        OUT.print(jobs_table(found))


def status(
    job: _JobId,
    address: _Address = DEFAULT_ADDRESS,
    as_json: AsJson = False,
) -> None:
    """Show the progress of a job, arm by arm, as the job reports it."""
    from jobs.remote.job import Job

    found = Job(job, address).status()
    if as_json:
        print_for_programs(asdict(found))
        return
    OUT.print(f"{found.job}: {found.state}", highlight=False)
    if found.message:
        OUT.print(found.message, highlight=False, markup=False)
    if found.progress is not None:
        OUT.print(arms_table(found.progress))
        if left := time_left(found.progress):
            OUT.print(left, highlight=False)
        OUT.print(f"results: {found.progress['results']}", highlight=False)


def logs(job: _JobId, address: _Address = DEFAULT_ADDRESS, follow: _Follow = False) -> None:
    """Show the output of a job."""
    from jobs.remote.job import Job

    if follow:
        _follow(Job(job, address))
    else:
        sys.stdout.write(printable_log(Job(job, address).logs()))


def stop(job: _JobId, address: _Address = DEFAULT_ADDRESS) -> None:
    """Stop a job once it has written checkpoints; `apel resume` continues it."""
    from jobs.remote.job import Job

    found = Job(job, address).stop()
    done, planned, *_ = totals(found.progress)
    OUT.print(f"{job}: {found.state}, {done} of {planned} runs are finished", highlight=False)


def resume(job: _JobId, address: _Address = DEFAULT_ADDRESS, follow: _Follow = False) -> None:
    """Resubmit a job from this machine: it resumes where it stopped, even on a cluster that has forgotten it."""
    from jobs.remote.job import Job

    resumed = Job(job, address).resume()
    _say_submitted(resumed)
    if follow:
        _follow(resumed)


def fetch(
    job: _JobId,
    destination: Annotated[Path, typer.Argument(metavar="DEST", help="A folder on this machine.")],
    address: _Address = DEFAULT_ADDRESS,
) -> None:
    """Copy the results that a job has so far into a folder on this machine."""
    from jobs.remote.job import Job

    OUT.print(str(Job(job, address).fetch(destination)), highlight=False)


def pack(results: str) -> None:
    """Pack results where the dashboard can serve them: the cluster's part of `apel fetch`."""
    from cluster.launch import ray_cluster
    from jobs.remote.packing import serve_archive

    with ray_cluster("auto") as info, stop_on_signals(lambda: None) as stopping:
        serve_archive(results, current_job(), info.log_folder, stopping)


def _say_submitted(job: Job) -> None:
    OUT.print(f"{job.id} is already running this" if job.was_running else job.id, highlight=False)


def _follow(job: Job) -> None:
    for piece in job.follow():
        sys.stdout.write(printable_log(piece))
        sys.stdout.flush()
    ended = job.wait()
    if ended.state != "done":
        raise typer.Exit(ended.exit_code or 1)
