"""Experiments as jobs of a Ray cluster, through its Jobs API: submit, watch, stop, go on, fetch.

The client needs nothing but the address of the cluster's dashboard, and its token in ``RAY_AUTH_TOKEN``,
``RAY_AUTH_TOKEN_PATH`` or ``~/.ray/auth_token``.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from jobs.experiment.spec import Experiment
from jobs.experiment.starts import with_agents
from jobs.experiment.user_modules import local_modules, named_modules, with_sources
from jobs.experiment.yaml_source import SpecError
from jobs.remote import DEFAULT_ADDRESS
from jobs.remote.connection import connected
from jobs.remote.fetching import fetch_results
from jobs.remote.package import write_package
from jobs.remote.places import place_on_cluster
from jobs.remote.records import Record, copy_package, read_record
from jobs.remote.status import Status, details_of, status_of
from jobs.remote.submission import submit_record, without_fresh

_POLL_SECONDS = 0.5


@dataclass(frozen=True)
class Job:
    """A submitted job; it may have been submitted by anybody."""

    id: str
    address: str
    was_running: bool = False
    """It was there already when the same was submitted again."""

    def status(self) -> Status:
        """How it is, as the job itself says.

        Raises
        ------
        ClusterError
            If the cluster cannot be asked, or knows no such job.
        """
        with connected(self.address) as client:
            return status_of(client, details_of(client, self.id))

    def logs(self) -> str:
        """What it has printed so far."""
        with connected(self.address) as client:
            details_of(client, self.id)
            return str(client.get_job_logs(self.id))

    def follow(self) -> Iterator[str]:
        """What it prints, piece by piece, until it ends."""
        with connected(self.address) as client:
            details_of(client, self.id)
            yield from _each(client.tail_job_logs(self.id))

    def wait(self, on_status: Callable[[Status], None] = lambda _: None) -> Status:
        """Wait until it has ended."""
        while True:
            status = self.status()
            on_status(status)
            if status.is_over:
                return status
            time.sleep(_POLL_SECONDS)

    def stop(self) -> Status:
        """Let it write checkpoints and end; waits until it has.

        A job that does not end within two minutes is killed, which costs the work since its last checkpoint.
        """
        with connected(self.address) as client:
            details_of(client, self.id)
            client.stop_job(self.id)
        return self.wait()

    def resume(self, address: str | None = None) -> Job:
        """Submit it again, here or at another address: it goes on where it stopped, also where it had started over.

        Raises
        ------
        SpecError
            If it was not submitted from this machine.
        """
        record = read_record(self.id)
        record = replace(record, address=address or self.address, options=without_fresh(record.options))
        return _submitted(record, lambda package: copy_package(record.job, package))

    def fetch(self, destination: str | Path) -> Path:
        """Copy its results, whatever there is by now, below ``destination``; returns the experiment's folder there.

        Raises
        ------
        ClusterError
            If the job has not said yet where its results lie, or they cannot be read.
        """
        return fetch_results(self.address, self.status(), Path(destination))


def submit(
    experiment: Experiment,
    *,
    address: str = DEFAULT_ADDRESS,
    options: Sequence[str] = (),
    results: str | None = None,
    modules: Sequence[str] = (),
    needed: Sequence[str] = (),
    folder: str | Path = ".",
) -> Job:
    """Submit an experiment to a Ray cluster; where it is running there already, that job is returned.

    Parameters
    ----------
    experiment:
        See `jobs.experiment.spec_files.load_experiment`.
    address:
        Of the cluster's dashboard, ``http://HOST:8265``.
    options:
        More words for `apel run`, such as ``("--placement", "packed")``.
    results:
        Path or URI that all nodes of the cluster can write to; None for what the cluster's ``APEL_RESULTS`` says.
    modules:
        Names of modules in ``folder`` to be sent, beside those that the experiment names and what these import.
    needed:
        Likewise, but those that are not there are expected to be installed on the cluster.
    folder:
        Where the user's own modules lie.

    Raises
    ------
    SpecError
        If a field, a module, or the place for the results cannot be right.
    BusyError
        If the same experiment is running there with other options, fewer runs, or other models to keep.
    ClusterError
        If the cluster cannot be reached.
    """
    words = [*options, *(("--results", place_on_cluster("--results", results)) if results else ())]
    experiment = with_agents(with_sources(experiment, [Path(folder).resolve()]))  # as the job itself will find it
    found = local_modules([*named_modules(experiment), *needed, *modules], Path(folder))
    missing = set(modules) - {path.stem for path in found}
    if missing:
        message = f"--module: found no module {sorted(missing)[0]!r} in {Path(folder).resolve()}"
        raise SpecError(message)
    models = experiment.models if isinstance(experiment.models, str) else f"every {experiment.models.every_steps} steps"
    of = experiment.name, experiment.identity
    record = Record("", address, *of, tuple(words), runs=experiment.runs, models=models)
    return _submitted(record, lambda package: write_package(experiment, found, package))


def _submitted(record: Record, pack: Callable[[Path], None]) -> Job:
    found = submit_record(record, pack)
    return Job(found.job, record.address, found.was_running)


def _each(pieces: AsyncIterator[str]) -> Iterator[str]:
    """The same without ``await``."""
    loop = asyncio.new_event_loop()
    try:
        while True:
            try:
                yield loop.run_until_complete(anext(pieces))
            except StopAsyncIteration:
                return
    finally:
        loop.close()
