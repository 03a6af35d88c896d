"""The same rows with continuous actions and replay buffers, value for value: in any shards, streaks, placements, and
after any fault.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from tests.cluster.losing import assert_goes_on
from tests.same_rows import assert_same, play

pytest.importorskip("stable_baselines3")

CONTINUOUS = """
name: continuous
runs: 2
episodes: 6
environment: {id: Pendulum-v1, max_episode_steps: 10}
learners:
  SAC: &small
    type: stable_baselines
    algorithm: "stable_baselines3:SAC"
    buffer_size: 50
    batch_size: 4
    learning_starts: 15
    policy_kwargs: {net_arch: [4]}
  TD3:
    <<: *small
    algorithm: "stable_baselines3:TD3"
    train_freq: [1, episode]
    gradient_steps: 3
    action_noise: {type: ornstein_uhlenbeck, sigma: 0.3}
arms:
  SAC: {learners: [SAC]}
  APEL: {learners: [SAC, TD3], selector: {type: apel, decay: 0.1}}
criterion: {measure: return, window: 3, at_least: -30, evaluation: greedy}
stop_when_met: false
record: all
"""


@pytest.fixture(scope="module")
def continuous(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of the experiment."""
    path = tmp_path_factory.mktemp("continuous") / "continuous.yaml"
    path.write_text(CONTINUOUS)
    return path


@pytest.fixture(scope="module")
def reference(continuous: Path) -> Path:
    """All runs of an arm in one shard, in this process."""
    return play(continuous, continuous.parent / "reference", placement="local", shard_size=100)


def test_shards_and_streaks_change_no_row(continuous: Path, reference: Path, tmp_path: Path) -> None:
    """Each run by itself, and in streaks of one episode."""
    execution = Execution(streak_episodes=1)
    assert_same(reference, play(continuous, tmp_path, placement="local", shard_size=1, execution=execution))


@pytest.mark.ray
def test_placement_changes_no_row(ray_session: None, continuous: Path, reference: Path, tmp_path: Path) -> None:
    """Ray actors give the rows that this process gives."""
    folder = play(continuous, tmp_path / "ray", placement="actors", shard_size=100, arms=("APEL",))
    assert_same(reference, folder, "APEL")


@pytest.mark.parametrize("rounds", [3])
def test_goes_on_from_the_checkpoint(continuous: Path, rounds: int) -> None:
    """A shard that is lost goes on with its buffers, noise and half-filled rollouts, and ends with the same rows."""
    shard = Plan.of(load_experiment(str(continuous))).only(["APEL"]).shards(num_cpus=1, shard_size=100)[-1]
    assert_goes_on(shard, rounds)
