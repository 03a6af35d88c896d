"""A share of its own of what is replayed: the same rows in any shards and streaks, after a loss, by Algorithm 5."""

from __future__ import annotations

from pathlib import Path

import pytest

from apel import Ensemble
from apel.building import make_selector
from cluster.learner_host import make_run_world
from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from tests.cluster.losing import assert_goes_on
from tests.same_rows import assert_same, episode_rows, play

SHARES = """
name: shares
runs: 4
episodes: 14
environment: {id: apel/CartPole-v0, options: {max_steps: 50}}
learners:
  DQN: {type: dqn, network: {hidden: [16]}, head_hidden: [8], batch_size: 8, learning_starts: 30, prioritized: {},
        exploration_fraction: 0.001, replay_size: 100, learns_from: {own_share: 0.7}}
  ACER: {type: acer, network: {hidden: [16]}, rollout: 8, learning_starts: 3, replay_size: 20, learning_rate: 0.02,
         learns_from: {own_share: 0.5}}
  SAC: {type: sac, network: {hidden: [16]}, batch_size: 8, learning_starts: 30, learning_rate: 0.02,
        learns_from: {own_share: 0.5}}
arms:
  APEL: {learners: [DQN, ACER, SAC], selector: {type: apel, decay: 0.05}}
record: all
"""


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of the experiment."""
    path = tmp_path_factory.mktemp("shares") / "shares.yaml"
    path.write_text(SHARES)
    return path


@pytest.fixture(scope="module")
def reference(spec: Path) -> Path:
    """All runs in one shard, in this process."""
    return play(spec, spec.parent / "reference", placement="local", shard_size=100)


@pytest.mark.parametrize(("shard_size", "streak"), [(1, 50), (100, 1), (3, 3)])
def test_shards_and_streaks_change_no_row(
    spec: Path, reference: Path, tmp_path: Path, shard_size: int, streak: int
) -> None:
    """However many runs lie in a shard, and however long a host keeps one."""
    execution = Execution(streak_episodes=streak)
    assert_same(reference, play(spec, tmp_path, placement="local", shard_size=shard_size, execution=execution))


@pytest.mark.parametrize("rounds", [3, 11])
def test_goes_on_from_the_checkpoint(spec: Path, rounds: int) -> None:
    """A shard that is lost ends with the rows of an undisturbed one."""
    shard = Plan.of(load_experiment(str(spec), ["runs=2"])).shards(num_cpus=1, shard_size=100)[-1]
    assert_goes_on(shard, rounds)


def test_as_algorithm_5(spec: Path, reference: Path) -> None:
    """A job stores what the readable loop gives."""
    shard = Plan.of(load_experiment(str(spec))).shards(num_cpus=1, shard_size=100)[0]
    arm, run = shard.arm, shard.runs[1]
    args = make_run_world(run), run.learners, make_selector(arm.selector), run.seed, arm.num_episodes
    records = list(Ensemble(*args, performance=arm.performance).run())
    stored = episode_rows(reference)
    rows = stored[stored["run_index"] == run.index]
    assert rows["selected"].tolist() == [record.selected for record in records]
    assert rows["return"].tolist() == [record.episode_return for record in records]


@pytest.mark.parametrize("learner", ["DQN", "ACER", "SAC"])
def test_each_matters(spec: Path, reference: Path, tmp_path: Path, learner: str) -> None:
    """Another share is another experiment, with other rows."""
    other = play(spec, tmp_path, f"learners.{learner}.learns_from=all", placement="local", shard_size=100)
    assert other.name != reference.name
    with pytest.raises(AssertionError):
        assert_same(reference, other)
