"""Submissions of the same experiment at once, in the order that does most harm: what each remembers, and sends."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from ray.job_submission import JobDetails, JobStatus, JobType

from cluster.errors import ClusterError
from jobs.experiment.spec_files import load_experiment
from jobs.experiment.yaml_source import SpecError
from jobs.remote import package, submission
from jobs.remote.job import Job, submit
from jobs.remote.records import package_folder, read_record, records_folder
from jobs.results.lease import BusyError

MOMENTS = pytest.mark.parametrize("moment", ["listed", "packed"])


class Cluster:
    """What is asked of a dashboard; like Ray's it takes what is sent, and then gives an id to the first who wants it.

    ``meanwhile`` is called once, in the middle of the next submission: when it was ``listed`` what jobs there are, or
    when it has ``packed`` and is about to send.
    """

    def __init__(self) -> None:
        self.jobs: dict[str, JobDetails] = {}
        self.num_sent = 0
        self.meanwhile: Callable[[], object] = int
        self.moment = "packed"

    def list_jobs(self) -> list[JobDetails]:
        found = list(self.jobs.values())
        self._reached("listed")
        return found

    def submit_job(
        self, *, entrypoint: str, submission_id: str, runtime_env: dict[str, Any], metadata: dict[str, str]
    ) -> None:
        self._reached("packed")
        assert (Path(runtime_env["working_dir"]) / "experiment.yaml").read_text().startswith("name: small-maze")
        self.num_sent += 1
        if submission_id in self.jobs:
            message = f"Job with submission_id {submission_id} already exists. Please use a different submission_id."
            raise RuntimeError(message)
        self.jobs[submission_id] = JobDetails(
            type=JobType.SUBMISSION,
            submission_id=submission_id,
            status=JobStatus.RUNNING,
            entrypoint=entrypoint,
            metadata=metadata,
        )

    def _reached(self, moment: str) -> None:
        if moment == self.moment:
            meanwhile, self.meanwhile = self.meanwhile, int
            meanwhile()


@pytest.fixture
def cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cluster:
    """The only cluster there is, whatever the address."""
    cluster = Cluster()

    @contextmanager
    def connected(_: str) -> Iterator[Cluster]:
        yield cluster

    monkeypatch.setattr(submission, "connected", connected)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return cluster


def remembered() -> set[str]:
    """All that lies in the folder of records, its lock apart."""
    return {path.name for path in records_folder().iterdir()} - {".lock"}


@MOMENTS
def test_the_same(cluster: Cluster, small: Path, moment: str) -> None:
    """The one that comes second is the first; what it had packed is gone, and what the first sent is still there."""
    experiment = load_experiment(str(small))
    firsts: list[Job] = []
    cluster.moment, cluster.meanwhile = moment, lambda: firsts.append(submit(experiment))
    second = submit(experiment)
    (first,) = firsts
    assert (first.was_running, second.was_running) == (False, True)
    assert first.id == second.id
    assert (list(cluster.jobs), cluster.num_sent) == ([first.id], 2)
    assert remembered() == {first.id}
    assert (package_folder(first.id) / "experiment.yaml").exists()


def test_one_that_breaks_off(cluster: Cluster, small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However far the other one comes with its packing, what this one sends is whole."""
    experiment = load_experiment(str(small))

    def break_off() -> None:
        with monkeypatch.context() as patch:
            patch.setattr(package, "_MAX_BYTES", -1)
            with pytest.raises(SpecError, match="expected at most"):
                submit(experiment)

    cluster.meanwhile = break_off
    job = submit(experiment)
    assert (job.was_running, list(cluster.jobs), remembered()) == (False, [job.id], {job.id})


@MOMENTS
def test_other_options(cluster: Cluster, small: Path, moment: str) -> None:
    """A second one with other options is refused, and the job's record keeps the options that the job has."""
    experiment = load_experiment(str(small))
    firsts: list[Job] = []
    cluster.moment, cluster.meanwhile = moment, lambda: firsts.append(submit(experiment, options=("--shard-size", "2")))
    with pytest.raises(BusyError, match="with the options '--shard-size 2'"):
        submit(experiment, options=("--shard-size", "3"))
    (first,) = firsts
    assert remembered() == {first.id}
    assert read_record(first.id).options == ("--shard-size", "2")


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (["runs=60"], "with runs: 6, models: none, expected one with runs: 60, models: none: wait for it or stop it"),
        (["models=final"], "with runs: 6, models: none, expected one with runs: 6, models: final"),
        (["models={every_steps: 50}"], "expected one with runs: 6, models: every 50 steps"),
    ],
)
def test_more_than_the_job_at_work_does(cluster: Cluster, small: Path, asked: list[str], message: str) -> None:
    """Neither runs nor models change the identity; whoever asks for more than is being done is told so."""
    first = submit(load_experiment(str(small)))
    with pytest.raises(BusyError, match=re.escape(message)):
        submit(load_experiment(str(small), asked))
    assert submit(load_experiment(str(small), ["runs=4"])).was_running
    assert list(cluster.jobs) == [first.id]


def test_of_a_job_of_an_older_version_nothing_is_known(cluster: Cluster, small: Path) -> None:
    """It is joined as ever."""
    first = submit(load_experiment(str(small)))
    for name in ("runs", "models"):
        (cluster.jobs[first.id].metadata or {}).pop(name)
    assert submit(load_experiment(str(small), ["runs=60"])).was_running


@MOMENTS
def test_resumed_twice(cluster: Cluster, small: Path, moment: str) -> None:
    """Likewise where a cluster has forgotten a job, and it is resumed twice, under its old id."""
    job = submit(load_experiment(str(small)), address="http://old:8265")
    cluster.jobs.clear()
    firsts: list[Job] = []
    cluster.moment, cluster.meanwhile = moment, lambda: firsts.append(job.resume("http://new:8265"))
    second = job.resume("http://newer:8265")
    (first,) = firsts
    assert (first.id, second.id, second.was_running) == (job.id, job.id, True)
    assert remembered() == {job.id}
    assert read_record(job.id).address == "http://new:8265"
    assert (package_folder(job.id) / "experiment.yaml").exists()


def test_refused(cluster: Cluster, small: Path) -> None:
    """Of a job that no cluster has accepted nothing is remembered."""

    def refuse() -> None:
        message = "too large"
        raise ClusterError(message)

    cluster.meanwhile = refuse
    with pytest.raises(ClusterError):
        submit(load_experiment(str(small)))
    assert not remembered()


def test_resumed_after_a_fresh_start(cluster: Cluster, small: Path) -> None:
    """A job that started over goes on when it is resumed: it does not start over once more."""
    job = submit(load_experiment(str(small)), options=("--fresh", "--shard-size", "2"))
    cluster.jobs.clear()
    resumed = job.resume()
    assert cluster.jobs[resumed.id].entrypoint == "apel run experiment.yaml --shard-size 2"
    assert read_record(resumed.id).options == ("--shard-size", "2")


def test_fresh_start_of_what_is_running(cluster: Cluster, small: Path) -> None:
    """Whoever does not ask to start over joins a job that did; whoever asks joins no job that did not."""
    experiment = load_experiment(str(small))
    job = submit(experiment, options=("--fresh",))
    assert submit(experiment).was_running
    assert submit(experiment, options=("--fresh",)).was_running
    assert job.resume().was_running
    cluster.jobs.clear()
    submit(experiment)
    with pytest.raises(BusyError, match="with the options ''"):
        submit(experiment, options=("--fresh",))
