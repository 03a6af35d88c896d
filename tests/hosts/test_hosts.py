"""The compose file's commands on three hosts that share nothing but a network: what listens, and what is lost.

``pytest -m hosts -s tests/hosts`` tells of each step, with the seconds since the beginning.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from jobs.experiment.spec_files import load_experiment
from jobs.runner import Settings, run_experiment
from tests.experiments import write_slow
from tests.hosts.cluster import RESULTS, Cluster, cluster, wait_until
from tests.hosts.compose import named_ports
from tests.hosts.hosts import Host
from tests.hosts.image import GID, HOME, UID
from tests.same_rows import assert_same, folder_of

pytestmark = [pytest.mark.hosts, pytest.mark.ray, pytest.mark.timeout(1800)]

MANY = ("runs=8", "episodes=3000")
# docs/security.md names them; Ray takes them without being told.
RAYS_OWN = {"head": {10001, 52365}, "worker": set[int]()}
RANDOM_PORTS = ("raylet", "ray::RuntimeEnv", "ray::DashboardA")
_SCAN = """
import socket, sys
for port in range(1, 65536):
    with socket.socket() as one:
        one.settimeout(5)
        if one.connect_ex((sys.argv[1], port)) == 0:
            print(port)
"""


@pytest.fixture(scope="module")
def tell() -> Callable[[str], None]:
    """Prints what has happened, with the seconds since the beginning."""
    began = time.monotonic()
    return lambda what: print(f"{time.monotonic() - began:7.1f} s  {what}", flush=True)  # noqa: T201


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory, tell: Callable[[str], None]) -> Iterator[Cluster]:
    """One cluster for all tests, which come in this order."""
    with cluster(tmp_path_factory.mktemp("hosts"), tell) as started:
        yield started
    tell("all is gone")


def test_hosts_share_no_disk(running: Cluster) -> None:
    """What one writes, wherever it may, no other one sees; the token is there, and Ray's user is nobody special."""
    places = ("/results", "/tmp", "/dev/shm", str(HOME))
    for node in running.nodes:
        node.run("touch", *(f"{place}/of-{node.name}" for place in places))
    for node in running.nodes:
        for place in places:
            found = node.run("ls", place).stdout.split()
            assert [name for name in found if name.startswith("of-")] == [f"of-{node.name}"]
        assert node.run("cat", "/run/secrets/ray-token").stdout == running.token
        state = node.run("cat", "/proc/self/status").stdout
        assert re.search(rf"^Uid:\t{UID}\t{UID}\t{UID}\t{UID}$", state, flags=re.MULTILINE)
        assert re.search(rf"^Gid:\t{GID}\t", state, flags=re.MULTILINE)
        assert re.findall(r"^Cap\w+:\t0*(\w+)$", state, flags=re.MULTILINE) == ["0"] * 5
        assert re.search(r"^NoNewPrivs:\t1$", state, flags=re.MULTILINE)


def test_objects_lie_in_shared_memory(running: Cluster) -> None:
    """Ray finds it large enough, and puts nothing on the disk instead."""
    for node in running.nodes:
        assert "Ray runtime started" in node.said()
        assert "/dev/shm" not in node.said()


@pytest.mark.parametrize("number", [0, 1, 2])
def test_what_listens(running: Cluster, number: int) -> None:
    """From another host a node is open at the ports that the compose file names, and at those that Ray takes."""
    node = running.nodes[number]
    service = node.name.partition("-")[0]
    named = named_ports(service) | RAYS_OWN[service]
    reached = {int(port) for port in running.client.run("python", "-c", _SCAN, node.name).stdout.split()}
    assert named <= reached
    owners = port_owners(node)
    assert {owners[port] for port in reached - named} <= set(RANDOM_PORTS), owners
    assert all(port >= 10002 for port in reached - named)
    # What is not reached is bound to loopback.
    assert set(owners) == reached


def port_owners(node: Host) -> dict[int, str]:
    """The ports at which others may reach a node, with the names of the programs that listen there."""
    found = {}
    for line in node.listening():
        address, program = re.findall(r'(\S+):\d+ +\S+ +users:\(\("(.*?)"', line)[0]
        if not re.search(r"\b127\.0\.0\.1\b|^\[::1\]$", address):
            found[int(re.findall(r":(\d+) ", line)[0])] = program
    return found


def test_token_is_asked_for(running: Cluster) -> None:
    """Without the token, or with another one, the dashboard and the nodes' agents refuse."""
    for url in ("http://head:8265/api/jobs/", "http://worker-1:52365/api/job_agent/jobs/"):
        assert [running.answer(url, token) for token in (None, "0" * 64)] == [401, 403]
    assert running.answer("http://head:8265/api/jobs/", running.token) == 200


def test_losses(running: Cluster, tmp_path: Path, tell: Callable[[str], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """A job goes on without a lost worker, and with another head; its rows are those of a local one."""
    slow_while = write_slow(tmp_path)
    bring(running, slow_while)
    job = submit(running)
    tell("the job is submitted")
    wait_until(lambda: all(plays(worker) for worker in running.workers), 600.0, lambda: running.apel("logs", job))
    wait_until(lambda: played(running, job) > 0, 600.0)
    assert re.search(rf"^ *{job} +running\b", running.apel("jobs"), flags=re.MULTILINE)
    tell("both workers play")
    lose_a_worker(running, job, tell)
    lose_the_head(running, tell)
    assert f"error: found no job '{job}' on this cluster" in running.apel("status", job, check=False)
    resumed = running.apel("resume", job).split()[0]
    tell("the job is resumed")
    for worker in running.workers:
        worker.path(slow_while).unlink()
    wait_until(lambda: state(running, resumed) == "done", 600.0, lambda: running.apel("logs", resumed))
    tell("the job is done")
    fetched = running.apel("fetch", resumed, "got").split()[0]
    tell("the results are fetched")
    slow_while.unlink()
    monkeypatch.syspath_prepend(tmp_path)
    experiment = load_experiment(str(tmp_path / "slow.yaml"), MANY)
    whole = run_experiment(experiment, Settings(str(tmp_path / "here"), placement="local"))
    assert_same(folder_of(whole), running.client.path(HOME / fetched))
    tell("its rows are those of the local one")


def test_stop(running: Cluster, tell: Callable[[str], None]) -> None:
    """A node that is asked to end does so before it would be killed."""
    for host in reversed(running.nodes):
        tell(f"{host.name} has stopped, after {host.stop():.1f} s")


def bring(running: Cluster, slow_while: Path) -> None:
    """The user has the experiment and its module; the workers have the file that makes it slow."""
    for name in ("slow.yaml", "user_code.py"):
        running.client.path(HOME / name).write_text((slow_while.parent / name).read_text())
    for worker in running.workers:
        worker.run("mkdir", "-p", str(slow_while.parent))
        worker.run("touch", str(slow_while))


def submit(running: Cluster) -> str:
    """Submit the experiment; the job's id."""
    sets = [word for field in MANY for word in ("--set", field)]
    words = ("slow.yaml", *sets, "--shard-size", "1", "--checkpoint-seconds", "5", "--results", RESULTS)
    return running.apel("submit", *words).split()[0]


def lose_a_worker(running: Cluster, job: str, tell: Callable[[str], None]) -> None:
    """Its power goes, and the job begins its shards again on the other one."""
    running.workers[0].lose()
    tell("a worker has lost its power")
    wait_until(lambda: running.status(job)["progress"]["restarts"] > 0, 300.0, lambda: running.apel("logs", job))
    tell("the job has noticed")
    assert "its processes died; restarting from its checkpoint" in running.apel("logs", job)
    before = played(running, job)
    wait_until(lambda: played(running, job) > before, 300.0)
    assert state(running, job) == "running"
    tell("the job has gone on")


def lose_the_head(running: Cluster, tell: Callable[[str], None]) -> None:
    """It is killed and comes back; the worker that it leaves ends, and both workers are started again."""
    running.head.kill()
    tell("the head is killed")
    running.head.start()
    running.head.wait_until_well()
    tell("another head is well")
    wait_until(running.workers[1].has_ended, 300.0, running.workers[1].said)
    tell("the worker that was left has ended")
    for worker in running.workers:
        worker.start()
    for worker in running.workers:
        worker.wait_until_well()
    wait_until(lambda: "/4.0 CPU" in running.head.run("ray", "status", check=False).stdout, 120.0)
    tell("both workers have joined it")


def plays(worker: Host) -> bool:
    """Whether learners are at work there."""
    return "ray::LearnerHost" in worker.run("ps", "-eo", "args").stdout


def played(running: Cluster, job: str) -> int:
    """How many episodes the job has played, as it says."""
    progress = running.status(job)["progress"]
    return sum(arm["episodes"] for arm in progress["arms"].values()) if progress else 0


def state(running: Cluster, job: str) -> str:
    """What has become of a job."""
    return str(running.status(job)["state"])
