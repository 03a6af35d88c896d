"""What environments carry over from one episode to the next, and shards that go on from a checkpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from apel.configs import EnvironmentConfig
from apel.environments import make_world
from apel.environments.carried_state import CarriedStateError
from apel.environments.environment_list import EnvironmentList
from apel.environments.probe import why_not_exact
from cluster.coordinator import Coordinator
from cluster.events import ShardDone
from cluster.local import LocalHosts
from cluster.shard import Execution
from jobs.experiment.spec_files import load_experiment
from jobs.progress.observers import Observer
from jobs.runner import Settings, run_experiment
from tests.border_code import Curriculum, Drift, StoredCurriculum, normalised, normalised_curriculum
from tests.cluster.test_coordinator import FailingHosts, Memory, play, shard_of

CODE = "tests.border_code"


class Forgetful(Drift):
    """Begins where the last episode ended."""

    last = 0.0

    def seen(self) -> Any:
        self.last += 1.0
        return np.array([self.last], np.float32)


class Unseeded(Drift):
    """Draws from a stream of its own."""

    def seen(self) -> Any:
        return np.random.default_rng().random(1, dtype=np.float32)


class Broken(Drift):
    """Raises at its second step."""

    def step(self, action: Any) -> Any:
        if self.at == 1:
            raise RuntimeError
        return super().step(action)


EXECUTION = Execution(streak_episodes=2, checkpoint_seconds=0.0, checkpoint_share=1.0)


def overrides(environment: str) -> tuple[str, ...]:
    """An ensemble of two learners, whose runs select by what the environment said."""
    return (
        f"environment={{id: '{CODE}:{environment}', max_episode_steps: 50}}",
        f"learners={{A: {{type: '{CODE}:Learner'}}, B: {{type: '{CODE}:Learner'}}}}",
        "arms={APEL: {learners: [A, B], selector: {type: apel}}}",
        "performance='tests.cluster.test_carried_state:seen'",
        "variables={}",
        "stop_when_met=false",
        "criterion={measure: length, window: 10, below: 1}",
        "plots=[]",
        "runs=2",
    )


def seen(trajectory: Any) -> float:
    """A measure of nothing but the observations and the rewards."""
    return float(np.abs(trajectory.observation).sum() + np.abs(trajectory.reward).sum())


@pytest.mark.parametrize(
    ("environment", "goes_on"),
    [
        ("Drift", True),
        ("normalised", True),
        ("StoredCurriculum", True),
        ("Curriculum", False),
        ("normalised_curriculum", False),
    ],
)
def test_rows_are_those_of_an_undisturbed_shard(small: Path, environment: str, goes_on: bool) -> None:
    """Whatever the environment carries: what is known of it is in the checkpoint, and where more is carried the shard
    begins anew.
    """
    shard = shard_of(small, *overrides(environment))
    undisturbed, memory, hosts = Memory(), Memory(), CountingHosts()
    play(shard, undisturbed, EXECUTION)
    with pytest.raises(ConnectionError):
        play(shard, memory, EXECUTION, FailingHosts(9))
    memory.rows.clear()
    *_, done = Coordinator(hosts, memory, memory, EXECUTION).run(shard)
    assert isinstance(done, ShardDone)
    assert memory.sorted_rows() == undisturbed.sorted_rows()
    assert hosts.num_prepared == (1 if goes_on else 2)


class CountingHosts(LocalHosts):
    """Counts how often they are prepared."""

    def __init__(self) -> None:
        super().__init__()
        self.num_prepared = 0

    def prepare(self, *arguments: Any) -> None:
        self.num_prepared += 1
        super().prepare(*arguments)


@pytest.mark.parametrize(
    ("made", "is_exact"),
    [
        (Drift, True),
        (normalised, True),
        (StoredCurriculum, True),
        (lambda: gymnasium.make("CartPole-v1"), True),
        (Forgetful, False),
        (Unseeded, False),
        (Broken, True),
    ],
)
def test_what_is_carried_from_the_first_episode_on_is_found_before_anything_is_played(
    made: Any, is_exact: bool
) -> None:
    """So that who waits for days knows what an interruption costs; what breaks is told of the run in which it does."""
    found = why_not_exact(lambda: make_world(EnvironmentConfig("x"), 1, made))
    assert (found is None) == is_exact


class Noting(Observer):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def noted(self, message: str) -> None:
        self.notes.append(message)


def test_it_is_said_at_the_start_and_in_the_manifest(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With what is to be done."""
    monkeypatch.setattr("jobs.runner.not_compiled", lambda _: [])  # nobody waits for it here
    changes = list(overrides("Drift"))
    changes[0] = "environment={id: 'tests.cluster.test_carried_state:Forgetful'}"
    experiment, observer = load_experiment(str(small), [*changes, "episodes=3", "runs=1"]), Noting()
    outcome = run_experiment(experiment, Settings(results=str(tmp_path), placement="local"), observer)
    (note,) = observer.notes
    assert "Give it the methods state() and restore(state)" in note
    assert note.endswith("Until then an interrupted shard starts over.")
    manifest = outcome.store.manifest()
    assert manifest is not None
    assert manifest["sessions"][0]["notes"] == [note]


def played(made: Any, num_episodes: int = 12) -> EnvironmentList:
    """After some episodes of at most 30 steps."""
    environments, runs = EnvironmentList([made(), made()]), np.array([0, 1])
    for episode in range(num_episodes):
        environments.reset(runs, [episode, 100 + episode])
        for _ in range(30):
            stepped = environments.step(runs, np.array([0, 1]))
            if stepped.terminated.any():
                break
    return environments


@pytest.mark.parametrize(
    ("made", "carries"),
    [
        (Drift, False),
        (normalised, False),
        (StoredCurriculum, False),
        (lambda: gymnasium.make("CartPole-v1"), False),
        (lambda: gymnasium.wrappers.FrameStackObservation(Drift(), 3), False),
        (Curriculum, True),
        (normalised_curriculum, True),
    ],
)
def test_new_environments_are_held_against_used_ones(made: Any, carries: bool) -> None:
    """A new one plays the last episode again; wrappers that are known to carry something are set to what they carried
    before it.
    """
    used, new = played(made), EnvironmentList([made(), made()])
    if carries:
        with pytest.raises(CarriedStateError, match=r"carries something over .* state\(\) and restore\(state\)"):
            new.restore(used.state())
        return
    state = used.state()
    new.restore(state)
    again = new.state()
    for one, other in zip(state["environments"], again["environments"], strict=True):
        assert repr(one["carried"]) == repr(other["carried"])
    runs = np.array([0, 1])
    for first, second in zip(following(used, runs), following(new, runs), strict=True):
        assert first == second


def following(environments: EnvironmentList, runs: Any) -> list[Any]:
    """The next episode."""
    told = [environments.reset(runs, [7, 8])]
    for _ in range(10):
        told.append(environments.step(runs, np.array([0, 1])))
        if told[-1].terminated.any():
            break
    return [(one.entry.tolist(), one.reward.tolist(), one.terminated.tolist()) for one in told]


def test_a_new_environment_is_held_against_nothing_before_the_first_episode() -> None:
    """There is nothing to play again."""
    EnvironmentList([Curriculum()]).restore(EnvironmentList([Curriculum()]).state())
