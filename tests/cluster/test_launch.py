"""What only Ray can show of the launcher."""

from __future__ import annotations

import socket
import time
from pathlib import Path

import pytest

from apel.seeding import Role, make_key, run_seeds
from cluster.checkpoint import CheckpointError
from cluster.errors import ClusterError, ShardLostError
from cluster.events import ShardDone
from cluster.retry import RetryPolicy
from cluster.shard import Execution
from jobs.plan import plan_shards
from jobs.spec_files import load_experiment
from tests.cluster.test_coordinator import Memory, with_user_code


def test_unreachable_address() -> None:
    """Where nothing listens the answer comes at once, and names the address."""
    from cluster.launch import ray_cluster

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    began = time.monotonic()
    with pytest.raises(ClusterError, match=f"could not reach a Ray cluster at '{address}'"), ray_cluster(address):
        pass
    assert time.monotonic() - began < 10


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

    shards = plan_shards(load_experiment(str(small)), 100, ["APEL"], set(), 1)
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

    shards = plan_shards(load_experiment(str(small)), 100, ["APEL"], set(), 1)
    names: set[str] = set()
    pool = ShardPool("named", "actors", Memory(), Memory(), Execution(streak_episodes=1, progress_seconds=0.0))
    for _ in pool.run(shards):
        names |= {actor["name"] for actor in ray.util.list_named_actors(all_namespaces=True)}
    assert names >= {"named/gang-0/coordinator", "named/gang-0/learner-0", "named/gang-0/learner-1"}
    deadline = time.monotonic() + 20
    while ray.util.list_named_actors(all_namespaces=True) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert ray.util.list_named_actors(all_namespaces=True) == []


@pytest.mark.ray
def test_errors_of_actors_come_as_they_were(ray_session: None, small: Path) -> None:
    """What a learner raises in its actor is told in one line, as in this process."""
    from cluster.pool import ShardPool

    unlucky = make_key(run_seeds(1234, 2)[1], Role.LEARNER, 1)
    overrides = (*with_user_code("", "tests.user_code:Superstitious"), f"learners.W.unlucky={unlucky}")
    shards = plan_shards(load_experiment(str(small), overrides), 100, ["APEL"], set(), 1)
    memory = Memory()
    *_, (_, done) = ShardPool("errors", "actors", memory, memory, Execution()).run(shards)
    assert isinstance(done, ShardDone)
    assert {failure.error for failure in done.failures} == {"tests.user_code:Superstitious: this seed brings no luck"}


@pytest.mark.ray
def test_state_that_cannot_be_stored(ray_session: None, small: Path) -> None:
    """A learner whose state no checkpoint can hold ends the job with the place, not with a retry."""
    from cluster.pool import ShardPool

    overrides = with_user_code("", "tests.user_code:Forgetful")
    shards = plan_shards(load_experiment(str(small), overrides), 100, ["APEL"], set(), 1)
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
