"""Environments are closed: those with a process of their own leave none behind."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from apel.configs import EnvironmentConfig
from apel.environments import close_environments, make_world
from cluster.coordinator import Coordinator
from cluster.events import ShardStopped
from cluster.local import LocalHosts, run_shards
from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from tests.cluster.test_coordinator import Memory
from tests.command_line import call

COUNTED = """
import gymnasium

OPEN, CLOSED = set(), []

class Counted(gymnasium.Env):
    observation_space = gymnasium.spaces.Discrete(3)
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, fails=""):
        OPEN.add(id(self))
        self.fails, self.steps = fails, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if self.fails == "reset":
            raise OSError("no port")
        return 0, {}

    def step(self, action):
        self.steps += 1
        if self.fails == "step" and self.steps > 5:
            raise OSError("the motor is stuck")
        return 1, 1.0, True, False, {}

    def close(self):
        OPEN.remove(id(self))
        CLOSED.append(id(self))
        if self.fails == "close":
            raise OSError("cannot be closed")

class Boxed(Counted):
    observation_space = gymnasium.spaces.Dict({"a": gymnasium.spaces.Box(0, 1, (2,))})

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), *super().step(action)[1:]

class Continuous(Counted):
    action_space = gymnasium.spaces.Box(0, 1, (2,))
"""
SPEC = """
name: counted
runs: 3
episodes: 20
environment: {id: "counted:Counted"}
learners:
  A: {type: q_learning}
  B: {type: q_learning}
arms:
  both: {learners: [A, B], selector: {type: uniform}}
"""


@pytest.fixture
def counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[object]:
    """The module of environments that count who is open."""
    (tmp_path / "counted.py").write_text(COUNTED)
    (tmp_path / "spec.yaml").write_text(SPEC)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    import counted  # type: ignore[import-not-found]

    yield counted
    del sys.modules["counted"]


@pytest.mark.parametrize(
    ("options", "code"),
    [([], 0), (["fails=close"], 0), (["fails=step"], 1), (["fails=reset"], 2)],
)
def test_nobody_stays_open(counted: object, capsys: pytest.CaptureFixture[str], options: list[str], code: int) -> None:
    """At the end, after failures, and where `validate` refuses: every environment is closed, and only once."""
    overrides = [word for option in options for word in ("--set", f"environment.options.{option}")]
    found, error = call(capsys, "run", "spec.yaml", "--placement", "local", "--quiet", *overrides)
    assert found == code, error
    assert set() == counted.OPEN  # type: ignore[attr-defined]
    assert counted.CLOSED  # type: ignore[attr-defined]
    call(capsys, "validate", "spec.yaml", *overrides)
    assert set() == counted.OPEN  # type: ignore[attr-defined]


def test_nobody_stays_open_after_a_stop(counted: object) -> None:
    """Nor where a job is asked to stop, or is left by an exception in the middle."""
    plan = Plan.of(load_experiment("spec.yaml", ["runs=2"]))
    shards = plan.shards(num_cpus=1)
    memory, execution = Memory(), Execution(streak_episodes=1, progress_seconds=0.0)
    played = run_shards(shards, memory, memory, execution)
    next(played)
    assert counted.OPEN  # type: ignore[attr-defined]
    played.close()
    assert set() == counted.OPEN  # type: ignore[attr-defined]
    coordinator = Coordinator(LocalHosts(), memory, memory, execution)
    events = coordinator.run(shards[0])
    next(events)
    coordinator.stop()
    assert isinstance(list(events)[-1], ShardStopped)
    assert set() == counted.OPEN  # type: ignore[attr-defined]


@pytest.mark.parametrize("kind", ["Counted", "Boxed", "Continuous"])
def test_worlds_can_be_closed(counted: object, kind: str) -> None:
    """Wrapped ones likewise; one that cannot be used is closed before that is said."""
    factory = getattr(counted, kind)
    try:
        world = make_world(EnvironmentConfig(f"counted:{kind}", max_episode_steps=5), 1, factory)
    except ValueError:
        assert kind == "Continuous"
    else:
        close_environments([world.environment] * 2)
    assert set() == counted.OPEN  # type: ignore[attr-defined]
    assert len(counted.CLOSED) == 1  # type: ignore[attr-defined]
