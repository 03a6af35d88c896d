"""What users run: experiments as files, or in a script, from a description to Parquet, tables and figures.

>>> import jobs
>>> experiment = jobs.load_experiment("distractor-maze", ["runs=10"])
>>> job = jobs.submit(experiment, address="http://127.0.0.1:8265")  # doctest: +SKIP
>>> job.wait().state, job.fetch("results")                          # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jobs.experiment.spec_files import load_experiment
    from jobs.progress.job_observer import JobInfo, JobObserver
    from jobs.progress.progress import ArmProgress
    from jobs.remote.job import Job, submit
    from jobs.remote.status import Status, list_jobs
    from jobs.runner import Settings, run_experiment
    from jobs.script.results import Results
    from jobs.script.running import FailedRunsError, run

__all__ = [
    "ArmProgress",
    "FailedRunsError",
    "Job",
    "JobInfo",
    "JobObserver",
    "Results",
    "Settings",
    "Status",
    "list_jobs",
    "load_experiment",
    "run",
    "run_experiment",
    "submit",
]

_HOMES = {
    "ArmProgress": "progress.progress",
    "FailedRunsError": "script.running",
    "Job": "remote.job",
    "JobInfo": "progress.job_observer",
    "JobObserver": "progress.job_observer",
    "Results": "script.results",
    "Settings": "runner",
    "Status": "remote.status",
    "list_jobs": "remote.status",
    "load_experiment": "experiment.spec_files",
    "run": "script.running",
    "run_experiment": "runner",
    "submit": "remote.job",
}


def _refuse_hidden_packages() -> None:
    """Say at once where a module of a user's is found in the place of a package that this one rests on."""
    from importlib.util import find_spec
    from pathlib import Path

    for name in ("apel", "cluster"):
        found = find_spec(name)
        if found is not None and found.origin and Path(found.origin).parent.parent != Path(__file__).parent.parent:
            message = (
                f"{found.origin}: found a module of yours called like the package {name!r} of this program, which it "
                "hides, expected another name: rename it"
            )
            raise ImportError(message)


_refuse_hidden_packages()


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for: submitting takes Ray, computing takes compiled code."""
    from importlib import import_module

    from jobs.missing_extra import missing_service

    if name not in __all__:
        message = f"module 'jobs' has no attribute {name!r}"
        raise AttributeError(message)
    try:
        return getattr(import_module(f"jobs.{_HOMES[name]}"), name)
    except ModuleNotFoundError as error:
        if message := missing_service(error):
            raise ModuleNotFoundError(message, name=error.name) from error
        raise
