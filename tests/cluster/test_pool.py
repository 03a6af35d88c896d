"""What the pool tells its state, and does of what that answers; the decisions are in `test_pool_state`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import pytest

from cluster.errors import LostClusterError
from cluster.events import ShardDone, ShardRestarted, ShardStopped
from cluster.pool import ShardPool, event_of_error
from cluster.pool_events import GangFailed, GangLost
from cluster.retry import RetryPolicy
from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from tests.cluster.pools import DONE, A, B, progress
from tests.cluster.shards import Memory


def test_whose_fault() -> None:
    """Processes that died are told from code that raised: only those may go better another time."""
    from ray.exceptions import ActorDiedError, NodeDiedError, RayTaskError

    died = ActorDiedError()
    event = event_of_error(3, died)
    assert event == GangLost(3, "The actor died unexpectedly before finishing this task.", died)
    # A coordinator that lost a learner raises what it was told of it.
    passed_on = RayTaskError("run", "Traceback …", NodeDiedError("the node is gone\nin two lines"))
    assert event_of_error(3, passed_on) == GangLost(3, "the node is gone", passed_on)
    raised = ValueError("found object")
    task = RayTaskError("run", "Traceback …", raised)
    assert event_of_error(3, task) == GangFailed(3, raised, task)


def test_actor_that_cannot_be_made() -> None:
    """What a constructor raises it would raise again: the job ends at once, with that exception in the first line."""
    from ray.exceptions import ActorDiedError, RayTaskError

    told = "ImportError: cannot import name 'kmeans'"
    trace = f"\x1b[36mray::Host.__init__()\x1b[39m\n  File cluster.py, line 1\n{told}\n"
    unmade = ActorDiedError(RayTaskError("__init__", trace, ImportError("cannot import name 'kmeans'")))
    for error in (unmade, RayTaskError("run", "Traceback …", unmade)):
        event = event_of_error(3, error)
        assert isinstance(event, GangFailed)
        assert event.cause is error
        first, *others = str(event.error).splitlines()
        assert first == f"a process of the job could not be made ready: {told}"
        assert "  File cluster.py, line 1" in others
        assert "\x1b" not in str(event.error)


def test_lost_cluster(dummies: dict[str, list[object]], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a Ray of our own has died nobody is asked anything any more: not even to end."""

    def lost() -> None:
        message = "the raylet is gone"
        raise LostClusterError(message)

    dummies |= {"e/gang-0": [progress(1), DONE], "e/gang-1": [DONE]}
    pool = _pool()
    events = pool.run([A, B])
    next(events)
    monkeypatch.setattr("cluster.pool.refuse_lost_cluster", lost)
    with pytest.raises(LostClusterError, match="the raylet is gone"):
        list(events)
    assert Dummy.living
    Dummy.living.clear()


class Dummy:
    """A gang without processes: it says what it is told to say."""

    living: ClassVar[set[str]] = set()
    says: ClassVar[dict[str, list[object]]] = {}

    def __init__(self, name: str, *_: object) -> None:
        self.name = name
        self.living.add(name)

    def start(self, _: object) -> Iterator[object]:
        """References to what it says; here they are what they refer to."""
        return iter(self.says[self.name])

    def close(self) -> list[object]:
        return []

    def kill(self) -> None:
        self.living.remove(self.name)


def _get(reference: object) -> object:
    if isinstance(reference, Exception):
        raise reference
    return reference


@pytest.fixture
def dummies(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[object]]:
    """Two CPUs, and gangs that say what is put here by their names; any of them are ready at any time."""
    import ray

    monkeypatch.setattr("cluster.pool.Gang", Dummy)
    monkeypatch.setattr("cluster.pool.num_cpus_of_cluster", lambda: 2)
    monkeypatch.setattr("cluster.pool.num_gpus_of_cluster", lambda: 0.0)
    monkeypatch.setattr(ray, "wait", lambda generators, **_: (generators[:1], generators[1:]))
    monkeypatch.setattr(ray, "get", _get)
    monkeypatch.setattr(Dummy, "living", set())
    monkeypatch.setattr(Dummy, "says", {})
    return Dummy.says


def _pool() -> ShardPool:
    return ShardPool("e", "actors", Memory(), Memory(), Execution(), RetryPolicy(2, first_delay_seconds=0.01))


def test_what_is_said_is_told(dummies: dict[str, list[object]]) -> None:
    """Reports come with their shards, a lost gang's shard goes to another one, and none is left at the end."""
    from ray.exceptions import ActorDiedError

    dummies |= {"e/gang-0": [progress(1), ActorDiedError()], "e/gang-1": [DONE], "e/gang-2": [progress(2), DONE]}
    pool = _pool()
    events = list(pool.run([A, B]))
    assert [event for shard, event in events if shard == B] == [DONE]
    restarted = ShardRestarted(1, 0.01, "The actor died unexpectedly before finishing this task.")
    assert [event for shard, event in events if shard == A] == [progress(1), restarted, progress(2), DONE]
    assert pool.num_restarts == 1
    assert Dummy.living == set()


def test_whatever_ends_the_job_ends_its_gangs(dummies: dict[str, list[object]]) -> None:
    """An error of user code comes as it was, with Ray's account of where as its cause; so does an interruption."""
    from ray.exceptions import RayTaskError

    raised = ValueError("found object")
    task = RayTaskError("run", "Traceback …", raised)
    dummies |= {"e/gang-0": [progress(1), task], "e/gang-1": [progress(1), DONE]}
    with pytest.raises(ValueError, match="found object") as error:
        list(_pool().run([A, B]))
    assert error.value is raised
    assert error.value.__cause__ is task
    assert Dummy.living == set()
    events = _pool().run([A, B])
    next(events)
    assert len(Dummy.living) == 2
    events.close()  # type: ignore[attr-defined]
    assert Dummy.living == set()


@pytest.mark.ray
def test_stop_leaves_checkpoints(ray_session: None, small: Path) -> None:
    """Shards that are asked to stop write a checkpoint and end; those that wait are not begun."""
    overrides = ("episodes=100000", "stop_when_met=false", "record=none")
    shards = Plan.of(load_experiment(str(small), overrides)).only(["APEL"]).shards(num_cpus=2, shard_size=1)
    execution = Execution(streak_episodes=1, progress_seconds=0.0, checkpoint_seconds=1e9)
    memory = Memory()
    heard = 0

    def stopping() -> bool:
        return heard > 5

    events = []
    for shard, event in ShardPool("stopped", "actors", memory, memory, execution).run(shards, stopping):
        events.append((shard.key, event))
        heard += 1
    stopped = {key for key, event in events if isinstance(event, ShardStopped)}
    assert 1 <= len(stopped) <= 2
    assert {key for key, _ in events} == stopped
    assert not any(isinstance(event, ShardDone | ShardRestarted) for _, event in events)
