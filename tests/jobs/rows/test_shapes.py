"""Runs of one arm whose environments differ in shape are the runs that they are by themselves, in any shards."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import pytest

from cluster.coordinator import Coordinator
from cluster.events import ShardDone, ShardProgress
from cluster.local import LocalHosts
from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from jobs.runner import Settings, run_experiment
from tests.cluster.shards import Memory
from tests.cluster.shards import play as play_shard
from tests.same_rows import assert_same, folder_of, play

_EXPERIMENT = """
name: shapes
runs: 5
episodes: 12
environment: {{{environment}}}
variables: {{drawn: [{values}]}}
learners: {{one: {{{learner}}}, other: {{{learner}}}}}
arms: {{APEL: {{learners: [one, other], selector: {{type: apel, decay: 0.1}}}}}}
record: all
"""
_MAZE = "id: apel/Maze-v0, run_seed: maze_seed, options: {{{options}}}"
_DQN = "type: dqn, network: {hidden: [8]}, learning_starts: 5"
KINDS = {
    "tables of two sizes": (_MAZE.format(options="size: $drawn, max_steps: 50"), "4, 5", "type: q_learning"),
    "two sizes, seen by a network": (_MAZE.format(options="size: $drawn, max_steps: 50"), "4, 5", _DQN),
    "two limits of steps": (_MAZE.format(options="size: 4, max_steps: $drawn"), "20, 30", _DQN),
    "images of two widths": (
        "id: 'tests.user_code:Framed', options: {width: $drawn}", "5, 6", "type: 'tests.user_code:Walker'",
    ),
}  # fmt: skip


@pytest.fixture(params=KINDS.values(), ids=KINDS.keys(), scope="module")
def spec(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of an experiment."""
    environment, values, learner = request.param
    path = tmp_path_factory.mktemp("shapes") / "shapes.yaml"
    path.write_text(_EXPERIMENT.format(environment=environment, values=values, learner=learner))
    return path


@pytest.fixture(scope="module")
def one_by_one(spec: Path) -> Path:
    """Every run in a shard of its own."""
    return play(spec, spec.parent / "one", placement="local", shard_size=1)


@pytest.mark.parametrize("shard_size", [2, 100])
def test_side_by_side(spec: Path, one_by_one: Path, tmp_path: Path, shard_size: int) -> None:
    """In any shards."""
    assert_same(one_by_one, play(spec, tmp_path, placement="local", shard_size=shard_size))


def test_stopped_again_and_again(spec: Path, one_by_one: Path, tmp_path: Path) -> None:
    """Stopped after every few rounds, in whatever part of its shard that is, it goes on to the same rows."""
    execution = Execution(streak_episodes=1, checkpoint_seconds=0.0, progress_seconds=0.0)
    settings = Settings(results=str(tmp_path), placement="local", shard_size=100, execution=execution)
    num_stops, was_stopped = 0, True
    while was_stopped:
        calls = count()
        outcome = run_experiment(load_experiment(str(spec)), settings, stopping=lambda calls=calls: next(calls) > 5)  # type: ignore[misc]
        assert outcome.failures == []
        was_stopped = outcome.was_stopped
        num_stops += was_stopped
    assert num_stops > 1
    assert_same(one_by_one, folder_of(outcome))


def test_told_as_one_shard(spec: Path) -> None:
    """Nothing that is counted from the beginning falls back where the next part begins, and the end is told once."""
    (shard,) = Plan.of(load_experiment(str(spec))).shards(num_cpus=1, shard_size=100)
    memory, execution = Memory(), Execution(streak_episodes=1, progress_seconds=0.0)
    *events, done = Coordinator(LocalHosts(), memory, memory, execution).run(shard)
    assert isinstance(done, ShardDone)
    reports = [event for event in events if isinstance(event, ShardProgress)]
    counted = [(one.num_finished, one.episodes, one.steps, one.rounds) for one in reports]
    assert len(reports) == len(events)
    assert all(list(column) == sorted(column) for column in zip(*counted, strict=True))
    assert counted[-1] == (5, 5 * 12, done.steps, done.rounds)
    alone = [play_shard(shard.only([position]), Memory()).steps for position in range(5)]
    assert done.steps == sum(alone)
