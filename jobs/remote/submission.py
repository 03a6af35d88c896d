"""How an experiment becomes a job of a Ray cluster, so that the same one, submitted twice, is the same job."""

from __future__ import annotations

import itertools
import re
import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from ray.job_submission import JobDetails, JobSubmissionClient

from jobs.remote.connection import connected
from jobs.remote.package import EXPERIMENT_FILE
from jobs.remote.records import Draft, Record, drafted
from jobs.remote.status import MARK, our_jobs
from jobs.results.lease import BusyError
from jobs.results.manifest import versions

_STOP_SECONDS = 120
_FRESH = "--fresh"
_NO_AGENT, _AGENT_SECONDS, _PAUSE_SECONDS = "No available agent", 180.0, 1.0


class Submitted(NamedTuple):
    """The id of a job, and whether it was there already when the same was submitted again."""

    job: str
    was_running: bool


def submit_record(record: Record, pack: Callable[[Path], None]) -> Submitted:
    """Submit under an id that Ray will not give twice, so that of two submissions at once one is second.

    Parameters
    ----------
    record:
        Of a job that has no id yet, or another cluster's.
    pack:
        Packs what is to be sent into a folder that does not exist.

    Raises
    ------
    BusyError
        If the same experiment is running there with other options.
    ClusterError
        If the cluster cannot be reached.
    """
    with connected(record.address) as client:
        while True:
            same = [job for job in our_jobs(client) if (job.metadata or {}).get("identity") == record.identity]
            for details in same:
                if not details.status.is_terminal() and _same_place(details, record):
                    return _attached(details, record)
            named = replace(record, job=f"{record.experiment}-{record.identity}-{_next_number(same)}")
            with drafted(named, pack) as draft:
                if _is_accepted(client, draft):
                    draft.keep()
                    return Submitted(named.job, was_running=False)


def without_fresh(options: Sequence[str]) -> tuple[str, ...]:
    """The options of a job that goes on: it must not forget what it has computed since it started over."""
    return tuple(word for word in options if word != _FRESH)


def _is_accepted(client: JobSubmissionClient, draft: Draft) -> bool:
    """Submit a job; False if somebody else's has got its id in the meantime.

    A head that has just started answers before the agent that starts jobs is there, for which it is waited.
    """
    deadline = time.monotonic() + _AGENT_SECONDS
    while True:
        try:
            return _is_accepted_now(client, draft)
        except RuntimeError as error:
            if _NO_AGENT not in str(error) or time.monotonic() >= deadline:
                raise
        time.sleep(_PAUSE_SECONDS)


def _is_accepted_now(client: JobSubmissionClient, draft: Draft) -> bool:
    try:
        client.submit_job(
            entrypoint=shlex.join(("apel", "run", EXPERIMENT_FILE, *draft.record.options)),
            submission_id=draft.record.job,
            runtime_env={
                "working_dir": str(draft.package),
                # Time for the checkpoints; Ray's own limit is three seconds.
                "env_vars": {"RAY_JOB_STOP_WAIT_TIME_S": str(_STOP_SECONDS)},
            },
            metadata=_metadata(draft.record),
        )
    except RuntimeError as error:
        if "already exists" in str(error):
            return False
        raise
    return True


def _metadata(record: Record) -> dict[str, str]:
    return {
        MARK: versions()["apel"],
        "job_name": record.experiment,  # what the dashboard calls it
        "experiment": record.experiment,
        "identity": record.identity,
        "options": shlex.join(record.options),
        **({} if record.runs is None else {"runs": str(record.runs), "models": str(record.models)}),
    }


def _attached(details: JobDetails, record: Record) -> Submitted:
    """The job that is at work already; whoever does not ask to start over may join one that did."""
    options = _options_of(details)
    if record.options not in (options, without_fresh(options)):
        message = (
            f"found the job {details.submission_id} at work on this experiment with the options "
            f"{shlex.join(options)!r}, expected none, or the same options: stop it, or wait for it"
        )
        raise BusyError(message)
    _refuse_more(details, record)
    return Submitted(str(details.submission_id), was_running=True)


def _refuse_more(details: JobDetails, record: Record) -> None:
    """See that a job at work does all that is asked for: neither runs nor models are part of the identity."""
    known = details.metadata or {}
    runs, models = known.get("runs"), known.get("models")
    if runs is None or record.runs is None or (record.runs <= int(runs) and record.models == models):
        return
    message = (
        f"found the job {details.submission_id} at work on this experiment with runs: {runs}, models: {models}, "
        f"expected one with runs: {record.runs}, models: {record.models}: wait for it or stop it, then submit again"
    )
    raise BusyError(message)


def _options_of(details: JobDetails) -> tuple[str, ...]:
    try:
        return tuple(shlex.split((details.metadata or {}).get("options", "")))
    except ValueError:
        return ()  # not this program's own


def _same_place(details: JobDetails, record: Record) -> bool:
    return _results_of(_options_of(details)) == _results_of(record.options)


def _results_of(options: Sequence[str]) -> str:
    return next((value for option, value in itertools.pairwise(options) if option == "--results"), "")


def _next_number(same: Sequence[JobDetails]) -> int:
    ends = (str(details.submission_id).rpartition("-")[2] for details in same)
    return max((int(end) for end in ends if re.fullmatch("[0-9]{1,9}", end)), default=0) + 1
