"""The soak: one job undisturbed, the same one disturbed, and what differs (nothing) and what it cost."""

from __future__ import annotations

import logging
import math
import os
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from jobs.results.storage import Folder
from tests.s3_server import NAME, Bucket, bucket
from tests.same_rows import assert_same
from tests.soak.faults import FaultError, Injector, all_injectors, deck
from tests.soak.job import PROJECT, Job
from tests.soak.pace import Pace
from tests.soak.storage_proxy import StorageProxy
from tests.soak.three_nodes import ThreeNodes, three_nodes
from tests.soak.timeline import Timeline

SPEC = """
name: soak
seed: 4711
runs: {runs}
episodes: {episodes}
environment:
  id: apel/Maze-v0
  run_seed: maze_seed
  options: {{size: 5, distractors: [3], max_steps: 100}}
variables:
  dropped: [x, y, distractor]
learners:
  Q_full: {{type: q_learning}}
  Q_red: {{type: q_learning, representation: {{exclude: [$dropped]}}}}
arms:
  Q_full: {{learners: [Q_full]}}
  APEL: {{learners: [Q_full, Q_red], selector: {{type: apel, decay: 0.01}}}}
  SSBAS: {{learners: [Q_full, Q_red], selector: {{type: ssbas}}}}
criterion: {{measure: length, window: 10, below: {{factor: 1.3, info: optimal_length}}}}
stop_when_met: false
record: all
"""
_NUM_ARMS = 3
# With as many learners to be hit as any, and the last of those to begin.
_HELD_ARM = "SSBAS"
# A learner alone plays ten episodes a round.
_WEIGHTS = {"Q_full": 0.1}
_CREDENTIALS = {
    "AWS_ACCESS_KEY_ID": "testing",
    "AWS_SECRET_ACCESS_KEY": "testing",
    "AWS_DEFAULT_REGION": "us-east-1",
    "AWS_EC2_METADATA_DISABLED": "true",
}
# The last fault comes before the last shards are over.
_LAST_POINT = 0.96
# Less than an episode of any arm.
_LEAST_WORK = 1e-6
# Some faults do not wait until the job has come further, so that they hit it while it recovers from another one.
_SHARE_OF_SEQUELS, _SEQUEL_SECONDS = 0.25, 4.0
_STANDSTILL_SECONDS = 400.0


@dataclass(frozen=True)
class Plan:
    """How large a soak is.

    Attributes
    ----------
    runs, shard_size, episodes:
        Of each of three arms; there must be more episodes than faults.
    round_seconds:
        A shard's round takes no less, so that on any machine the job goes on for long enough.
    baseline:
        Whether to play it undisturbed on the same cluster, for its wall time.
    """

    num_faults: int
    seed: int
    runs: int
    episodes: int
    round_seconds: float
    shard_size: int = 2
    worker_cpus: tuple[int, ...] = (2, 1)
    baseline: bool = True

    @property
    def work(self) -> float:
        """What `Timeline.work` is in the end."""
        arms = _NUM_ARMS - len(_WEIGHTS) + sum(_WEIGHTS.values())
        return arms * (self.runs * self.episodes + -(-self.runs // self.shard_size)) - 1e-6


@dataclass
class Fault:
    """A fault that hit something; times in seconds since the job began."""

    kind: str
    began: float
    ended: float
    hit: str
    lost: float | None = None
    """Seconds that the job as a whole lost from then until the next fault: what it took longer than undisturbed."""
    waited: float | None = None
    """The longest time that a shard came no further then, its wait for a free CPU included."""


@dataclass
class Result:
    """What came of a soak; it is well if there are no ``problems``."""

    faults: list[Fault] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    undisturbed_seconds: float | None = None
    disturbed_seconds: float = 0.0
    pace: float | None = None
    """Work per second of the undisturbed job, from its plan to its last row."""
    num_sessions: int = 0
    num_restarts: int = 0
    """How often a shard began again within a session."""
    num_runs: int = 0
    num_episodes: int = 0
    temporary_files: int = 0
    """Left by processes that were killed, until the next start of the command."""
    unfinished_uploads: int = 0
    """Likewise; nothing but a rule of the bucket removes them."""

    def kinds(self) -> dict[str, dict[str, float]]:
        """By kind of fault: the count, and seconds lost."""
        kinds = defaultdict(list)
        for fault in self.faults:
            kinds[fault.kind].append(fault)
        return {kind: _spread(faults) for kind, faults in sorted(kinds.items())} | {"all": _spread(self.faults)}

    def seconds_per_fault(self) -> float | None:
        """Wall time that the job took longer for, by the number of faults."""
        if self.undisturbed_seconds is None or not self.faults:
            return None
        return (self.disturbed_seconds - self.undisturbed_seconds) / len(self.faults)

    def as_json(self) -> dict[str, Any]:
        """As plain values."""
        return {**asdict(self), "kinds": self.kinds(), "seconds_per_fault": self.seconds_per_fault()}


def soak(plan: Plan, tell: Callable[[str], None], logs: Path | None = None) -> Result:
    """Play it all; ``tell`` is told a line per event. Must be called in the main thread.

    What the drivers have written is kept in ``logs``.
    """
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    os.environ |= _CREDENTIALS
    with (
        tempfile.TemporaryDirectory(prefix="soak-") as name,
        bucket() as s3,
        _undisturbed(plan, Path(name)) as local,
        three_nodes(plan.worker_cpus) as nodes,
        closing(StorageProxy(s3.host, s3.port, random.Random(plan.seed))) as proxy,
    ):
        try:
            return _soak(plan, Path(name), local, s3, nodes, proxy, tell)
        finally:
            if logs is not None:
                shutil.copytree(name, logs, dirs_exist_ok=True, ignore=shutil.ignore_patterns("copy", "local"))


@contextmanager
def _undisturbed(plan: Plan, folder: Path) -> Iterator[Callable[[], Path]]:
    """Play without Ray, beside what else there is to do; yields a function that waits for the results' folder."""
    spec = folder / "soak.yaml"
    spec.write_text(SPEC.format(runs=plan.runs, episodes=plan.episodes))
    command = [sys.executable, "-m", "jobs", "run", str(spec), "--placement", "local", "--quiet"]
    process = subprocess.Popen([*command, "--results", str(folder / "local")], cwd=PROJECT)

    def wait() -> Path:
        if process.wait(timeout=600):
            message = f"the undisturbed job ended with exit code {process.returncode}"
            raise RuntimeError(message)
        return next((folder / "local").rglob("runs.parquet")).parent

    try:
        yield wait
    finally:
        process.kill()
        process.wait()


def _soak(
    plan: Plan,
    folder: Path,
    local: Callable[[], Path],
    s3: Bucket,
    nodes: ThreeNodes,
    proxy: StorageProxy,
    tell: Callable[[str], None],
) -> Result:
    result = Result()
    pace = Pace(plan.round_seconds, _HELD_ARM, plan.runs - 1, str(folder / "faults-to-come"))

    def new_job(name: str) -> Job:
        root = f"s3://{NAME}/{name}?endpoint_override=127.0.0.1:{proxy.port}&scheme=http"
        words = [pace.as_word(), "run", str(folder / "soak.yaml"), "--address", nodes.address, "--results", root]
        return Job(
            [*words, "--shard-size", str(plan.shard_size), "--checkpoint-seconds", "0.5"],
            folder / name,
            Timeline(weights=_WEIGHTS),
        )

    local()  # not beside a job whose time is taken
    if plan.baseline:
        with closing(new_job("undisturbed")) as job:
            code = job.wait(3600.0)
            result.undisturbed_seconds = time.monotonic() - job.began
            result.pace = plan.work / (job.timeline.last() - job.timeline.first)
        tell(f"undisturbed: exit code {code} after {result.undisturbed_seconds:.1f} s")
    pace.expect(plan.num_faults)
    with closing(new_job("disturbed")) as job:
        try:
            _disturb(plan, pace, job, nodes, all_injectors(nodes, job, proxy), result, tell)
            _finish(job, result)
        except TimeoutError as error:
            result.problems.append(str(error))
            return result
        result.disturbed_seconds = time.monotonic() - job.began
        result.num_sessions, result.num_restarts = job.num_sessions, job.timeline.num_restarts
        result.problems += [f"waited for a dead driver's lease: {wait}" for wait in job.waits]
        _account(job, plan, result)
        result.problems += [f"left over in the cluster: {what}" for what in nodes.left_over()]
        _inspect(job, s3, local(), folder / "copy", plan, result)
    return result


def _disturb(
    plan: Plan,
    pace: Pace,
    job: Job,
    nodes: ThreeNodes,
    injectors: list[tuple[Injector, int]],
    result: Result,
    tell: Callable[[str], None],
) -> None:
    moment = random.Random(plan.seed)
    for number, injector in enumerate(deck(injectors, plan.num_faults, moment)):
        point = (number + moment.random()) / plan.num_faults * _LAST_POINT * plan.work
        if number and moment.random() < _SHARE_OF_SEQUELS:
            _go_on(job, result, time.monotonic() + moment.uniform(0.0, _SEQUEL_SECONDS), math.inf)
        else:
            # Past its point, where faults took longer than the job to come there, it has at least recovered.
            _go_on(job, result, None, max(point, job.timeline.work() + _LEAST_WORK))
        fault = _hit(injector, moment, job, nodes, result)
        if fault is None:
            result.problems.append(f"the job was over after {number} of {plan.num_faults} faults")
            return
        result.faults.append(fault)
        pace.expect(plan.num_faults - number - 1)
        done = 100 * job.timeline.work() / plan.work
        tell(f"{fault.began:7.1f} s  {done:4.1f} %  {number + 1:3d}  {injector.name:18s}  {fault.hit}")


def _hit(injector: Injector, moment: random.Random, job: Job, nodes: ThreeNodes, result: Result) -> Fault | None:
    """Inject a fault as soon as there is something to be hit; None if the job is over before.

    Raises
    ------
    TimeoutError
        If there is nothing for too long.
    """
    deadline = time.monotonic() + _STANDSTILL_SECONDS
    while time.monotonic() < deadline:
        if died := nodes.died_unasked():
            result.problems.append(f"{died} nodes died by themselves")
        began = time.monotonic()
        try:
            hit = injector.inject(moment)
        except FaultError as error:
            hit = "the job took it amiss"
            result.problems.append(str(error))
        code = job.poll()
        if hit:
            return Fault(injector.name, began - job.began, time.monotonic() - job.began, hit)
        if code == 0:
            return None
        _go_on(job, result, time.monotonic() + 0.1, math.inf)
    message = f"{injector.name}: found nothing to hit for {_STANDSTILL_SECONDS:.0f} s"
    raise TimeoutError(message)


def _go_on(job: Job, result: Result, until: float | None, point: float) -> None:
    """Let the job go on until some time, or to some point; a driver that ends with an error is started again."""
    came_to, moved = job.timeline.work(), time.monotonic()
    while job.timeline.work() < point and (until is None or time.monotonic() < until):
        code = job.poll()
        if code == 0:
            return
        if code is not None:
            result.problems.append(f"the driver ended with exit code {code}:\n{job.said()}")
            job.start()
        if job.timeline.work() != came_to:
            came_to, moved = job.timeline.work(), time.monotonic()
        if time.monotonic() - moved > _STANDSTILL_SECONDS:
            message = f"the job has not come further for {_STANDSTILL_SECONDS:.0f} s"
            raise TimeoutError(message)
        time.sleep(0.02)


def _finish(job: Job, result: Result) -> None:
    """Let the job come to its end; then the same command must find all done, and tidy up."""
    while (code := job.wait(600.0)) != 0:
        result.problems.append(f"the driver ended with exit code {code}:\n{job.said()}")
        job.start()


def _inspect(job: Job, s3: Bucket, local: Path, copy: Path, plan: Plan, result: Result) -> None:
    """What the storage holds once the job is over."""
    import boto3

    folder = Folder(f"s3://{NAME}/disturbed?{s3.query}")
    client = boto3.client("s3", endpoint_url=f"http://{s3.host}:{s3.port}")
    result.temporary_files = len(folder.temporary_names())
    result.unfinished_uploads = len(client.list_multipart_uploads(Bucket=NAME).get("Uploads", []))
    before = job.timeline.work()
    job.start()
    if (code := job.wait(120.0)) or job.timeline.work() != before:
        result.problems.append(f"the same command once more: exit code {code}\n{job.said()}")
    unwanted = ("claims", "checkpoints", "spilled")
    left = [name for name in folder.names() if name.split("/")[2] in unwanted] + folder.temporary_names()
    result.problems += [f"left over in the storage: {name}" for name in left]
    for name in folder.names():
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_bytes(folder.read(name))
    _compare(next(copy.rglob("runs.parquet")).parent, local, plan, result)


def _compare(disturbed: Path, local: Path, plan: Plan, result: Result) -> None:
    parts = [
        pq.ParquetFile(path).read(["arm", "sweep", "run_index"]) for path in (disturbed / "parts").rglob("*.parquet")
    ]
    keys = [key for part in parts for key in zip(*(column.to_pylist() for column in part.columns), strict=True)]
    result.num_runs = len(keys)
    if len(keys) != len(set(keys)) or len(keys) != _NUM_ARMS * plan.runs:
        result.problems.append(f"found {len(keys)} rows of {len(set(keys))} runs, expected {_NUM_ARMS * plan.runs}")
    files = (disturbed / "episodes").rglob("*.parquet")
    result.num_episodes = sum(pq.ParquetFile(path).metadata.num_rows for path in files)
    try:
        assert_same(local, disturbed)
    except AssertionError as error:
        result.problems.append(f"rows differ: {error}")


def _account(job: Job, plan: Plan, result: Result) -> None:
    """Say of each fault what it cost."""
    times = [*(job.began + fault.began for fault in result.faults), job.timeline.last()]
    for fault, began, following in zip(result.faults, times, times[1:], strict=False):
        fault.waited = job.timeline.stall(began, job.began + fault.ended)
        if result.pace is not None:
            done = job.timeline.work(following) - job.timeline.work(began)
            fault.lost = following - began - done / result.pace


def _spread(faults: Sequence[Fault]) -> dict[str, float]:
    spread: dict[str, float] = {"count": len(faults)}
    for name in ("lost", "waited"):
        if known := [value for fault in faults if (value := getattr(fault, name)) is not None]:
            spread |= {f"median_{name}": statistics.median(known), f"max_{name}": max(known)}
    return spread
