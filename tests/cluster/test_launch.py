"""What only Ray can show of the launcher."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import Literal

import pytest

from apel.numerics.seeding import Role, make_key, run_seeds
from cluster.checkpoint import CheckpointError
from cluster.errors import ClusterError, ShardLostError
from cluster.events import ShardDone
from cluster.retry import RetryPolicy
from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from tests.cluster.shards import Memory, with_user_code


def test_unreachable_address(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing listens Ray, which tries for a quarter of an hour, is not asked; the answer names the address."""
    import ray

    from cluster.launch import ray_cluster

    monkeypatch.setattr(ray, "init", lambda **_: pytest.fail("Ray was asked"))

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(ClusterError, match=f"could not reach a Ray cluster at '{address}'"), ray_cluster(address):
        pass


def test_loopback_alone() -> None:
    """A head that listens at the loopback alone is told at once: Ray would look for it at the machine's address."""
    from cluster.launch import ray_cluster

    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        address = f"127.0.0.1:{listening.getsockname()[1]}"
        with pytest.raises(ClusterError, match=f"found no cluster of '{address}' at"), ray_cluster(address):
            pass


class Doomed(Memory):
    """A checkpoint store on which every coordinator dies."""

    def read(self, shard: object) -> bytes | None:
        import os

        os._exit(1)


@pytest.mark.ray
def test_gives_up(ray_session: None, small: Path) -> None:
    """A shard whose processes die again and again is given up after a bounded number of faults."""
    from cluster.pool import ShardPool

    shards = Plan.of(load_experiment(str(small))).only(["APEL"]).shards(num_cpus=1, shard_size=100)
    retry = RetryPolicy(max_attempts=2, first_delay_seconds=0.01)
    pool = ShardPool("doomed", "packed", Doomed(), Doomed(), Execution(), retry)
    with pytest.raises(ShardLostError, match="its processes died 2 times"):
        list(pool.run(shards))
    assert pool.num_restarts == 2


@pytest.mark.ray
def test_speaking_names(ray_session: None, small: Path) -> None:
    """Actors carry the experiment, the gang and their role; they are gone when the job is over."""
    import ray

    from cluster.pool import ShardPool

    shards = Plan.of(load_experiment(str(small))).only(["APEL"]).shards(num_cpus=1, shard_size=100)
    names: set[str] = set()
    pool = ShardPool("named", "actors", Memory(), Memory(), Execution(streak_episodes=1, progress_seconds=0.0))
    for _ in pool.run(shards):
        names |= {actor["name"] for actor in ray.util.list_named_actors(all_namespaces=True)}
    assert names >= {"named/gang-0/coordinator", "named/gang-0/learner-0", "named/gang-0/learner-1"}
    deadline = time.monotonic() + 60
    while ray.util.list_named_actors(all_namespaces=True) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert ray.util.list_named_actors(all_namespaces=True) == []


@pytest.mark.ray
def test_errors_of_actors_come_as_they_were(ray_session: None, small: Path) -> None:
    """What a learner raises in its actor is told in one line, as in this process."""
    from cluster.pool import ShardPool

    unlucky = make_key(run_seeds(1234, 2)[1], Role.LEARNER, 1)
    overrides = (*with_user_code("", "tests.user_code:Superstitious"), f"learners.W.unlucky={unlucky}")
    shards = Plan.of(load_experiment(str(small), overrides)).only(["APEL"]).shards(num_cpus=1, shard_size=100)
    memory = Memory()
    *_, (_, done) = ShardPool("errors", "actors", memory, memory, Execution()).run(shards)
    assert isinstance(done, ShardDone)
    assert {failure.error for failure in done.failures} == {"tests.user_code:Superstitious: this seed brings no luck"}


@pytest.mark.ray
@pytest.mark.parametrize("layout", ["actors", "packed"])
def test_faults_in_actors(ray_session: None, small: Path, tmp_path: Path, layout: Literal["actors", "packed"]) -> None:
    """`sys.exit` in an actor ends its runs with their traceback, and no process; every environment is closed."""
    from cluster.pool import ShardPool

    (tmp_path / "open").mkdir()
    options = f"{{folder: {tmp_path / 'open'}, fault: exit, episode: 5}}"
    overrides = (*with_user_code(""), f"environment={{id: 'tests.user_code:Marked', options: {options}}}")
    shards = Plan.of(load_experiment(str(small), overrides)).only(["APEL"]).shards(num_cpus=1, shard_size=100)
    memory = Memory()
    pool = ShardPool("exits", layout, memory, memory, Execution())
    *_, (_, done) = pool.run(shards)
    assert isinstance(done, ShardDone)
    assert {failure.error for failure in done.failures} == {"SystemExit: the window was closed"}
    assert len(done.failures) == 6
    assert {failure.part for failure in done.failures} == {"environment"}
    assert all('sys.exit("the window was closed")' in failure.trace for failure in done.failures)
    assert all("user_code.py" in failure.place for failure in done.failures)
    assert pool.num_restarts == 0
    assert list((tmp_path / "open").iterdir()) == []


@pytest.mark.ray
def test_state_that_cannot_be_stored(ray_session: None, small: Path) -> None:
    """A learner whose state no checkpoint can hold ends the job with the place, not with a retry."""
    from cluster.pool import ShardPool

    overrides = with_user_code("", "tests.user_code:Forgetful")
    shards = Plan.of(load_experiment(str(small), overrides)).only(["APEL"]).shards(num_cpus=1, shard_size=100)
    pool = ShardPool(
        "forgetful",
        "actors",
        Memory(),
        Memory(),
        Execution(streak_episodes=1, checkpoint_seconds=0.0, checkpoint_share=1.0),
    )
    with pytest.raises(CheckpointError, match=r"generator: found object"):
        list(pool.run(shards))
    assert pool.num_restarts == 0
