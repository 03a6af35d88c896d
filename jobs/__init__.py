"""What users run: experiments as files, from a description to Parquet, tables and figures.

>>> import jobs
>>> experiment = jobs.load_experiment("distractor-maze", ["runs=10"])
>>> job = jobs.submit(experiment, address="http://127.0.0.1:8265")  # doctest: +SKIP
>>> job.wait().state, job.fetch("results")                          # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jobs.remote.submission import Job, Status, list_jobs, submit
    from jobs.runner import Settings, run_experiment
    from jobs.spec_files import load_experiment

__all__ = ["Job", "Settings", "Status", "list_jobs", "load_experiment", "run_experiment", "submit"]

_HOMES = {"Settings": "runner", "run_experiment": "runner", "load_experiment": "spec_files"}


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for: submitting takes Ray, computing takes compiled code."""
    from importlib import import_module

    if name not in __all__:
        message = f"module 'jobs' has no attribute {name!r}"
        raise AttributeError(message)
    return getattr(import_module(f"jobs.{_HOMES.get(name, 'remote.submission')}"), name)
