"""The same rows from deep learners, value for value: in any shards, streaks, placements, and after any fault."""

from __future__ import annotations

from pathlib import Path

import pytest

from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from tests.cluster.losing import assert_goes_on
from tests.same_rows import assert_same, play

DEEP = """
name: deep
runs: 5
episodes: 12
environment: {id: apel/CartPole-v0, options: {max_steps: 50}}
learners:
  Q:
    type: q_learning
    representation: {bins: [{low: -1, high: 1, count: 1}, {low: -1, high: 1, count: 1},
                            {low: -0.2, high: 0.2, count: 4}, {low: -2, high: 2, count: 3}]}
  DQN: {type: dqn, network: {hidden: [16]}, head_hidden: [8], batch_size: 8, learning_starts: 30, prioritized: {},
        exploration_fraction: 0.001, target_update_every: 50, replay_size: 100}
  ACER: {type: acer, network: {hidden: [16]}, rollout: 8, learning_starts: 3, replay_size: 20, replay_ratio: 2}
  SAC: {type: sac, network: {hidden: [16]}, batch_size: 8, learning_starts: 30}
arms:
  DQN: {learners: [DQN]}
  SAC: {learners: [SAC]}
  APEL: {learners: [Q, DQN, ACER], selector: {type: apel, decay: 0.05}}
criterion: {measure: return, window: 3, at_least: 25}
stop_when_met: false
steady_state_episodes: 4
record: all
"""


@pytest.fixture(scope="module")
def deep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of the experiment."""
    path = tmp_path_factory.mktemp("deep") / "deep.yaml"
    path.write_text(DEEP)
    return path


@pytest.fixture(scope="module")
def reference(deep: Path) -> Path:
    """All runs of an arm in one shard, in this process."""
    return play(deep, deep.parent / "reference", placement="local", shard_size=100)


@pytest.mark.parametrize(("shard_size", "streak"), [(1, 50), (100, 1), (2, 3)])
def test_shards_and_streaks_change_no_row(
    deep: Path, reference: Path, tmp_path: Path, shard_size: int, streak: int
) -> None:
    """However many runs share a tensor, and however long: their rows are those of a run by itself, bit for bit."""
    execution = Execution(streak_episodes=streak)
    assert_same(reference, play(deep, tmp_path / "cut", placement="local", shard_size=shard_size, execution=execution))


@pytest.mark.ray
@pytest.mark.parametrize(
    ("placement", "shard_size", "arms"), [("actors", 100, ("APEL",)), ("packed", 3, ("DQN", "SAC", "APEL"))]
)
def test_placement_changes_no_row(
    ray_session: None,
    deep: Path,
    reference: Path,
    tmp_path: Path,
    placement: str,
    shard_size: int,
    arms: tuple[str, ...],
) -> None:
    """Ray actors give the rows that this process gives."""
    folder = play(deep, tmp_path / "ray", placement=placement, shard_size=shard_size, arms=arms)
    assert_same(reference, folder, *arms)


@pytest.mark.parametrize(("arm", "rounds"), [("DQN", 4), ("SAC", 7), ("APEL", 2), ("APEL", 9)])
def test_goes_on_from_the_checkpoint(deep: Path, arm: str, rounds: int) -> None:
    """A shard that is lost ends with the rows, train times and steady states of an undisturbed one."""
    shard = Plan.of(load_experiment(str(deep), ["runs=3"])).only([arm]).shards(num_cpus=1, shard_size=100)[-1]
    assert_goes_on(shard, rounds)
