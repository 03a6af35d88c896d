"""Breakout through the whole pipeline: learners with different worlds in their heads, the same rows however played."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from tests.cluster.losing import assert_goes_on
from tests.same_rows import assert_same, episode_rows, play

SMALL_DQN = (
    "batch_size: 4, learning_starts: 20, train_every: 2, target_update_every: 20, replay_size: 60, prioritized: {}"
)
MINATAR = f"""
name: minatar
runs: 3
episodes: 100
steps: 150
environment: {{id: apel/MinAtarBreakout-v0}}
learners:
  Q: {{type: q_learning, representation: {{channel: handcrafted, reward: paddle_hit}}}}
  DQN: {{type: dqn, representation: {{channel: symbols, stack: 1}}, dueling: false, head_hidden: [], {SMALL_DQN},
        network: {{convolutions: [[4, 3, 1]], hidden: [8], activation: relu}}}}
arms:
  Q: {{learners: [Q]}}
  APEL: {{learners: [Q, DQN], selector: {{type: apel, decay: 0.05}}}}
record: all
"""
ATARI = f"""
name: atari
runs: 2
episodes: 5
steps: 130
environment: {{id: apel/AtariBreakout-v0, options: {{max_steps: 70}}}}
learners:
  Q: {{type: q_learning, representation: {{channel: handcrafted, reward: paddle_hit, terminal: life_lost}}}}
  DQN: {{type: dqn, representation: {{channel: frame, stack: 4, reward: clipped, terminal: life_lost}}, {SMALL_DQN},
        network: {{convolutions: [[4, 8, 8], [4, 3, 2]], padding: same, hidden: [], activation: relu}},
        head_hidden: [8]}}
arms:
  DQN: {{learners: [DQN]}}
  APEL: {{learners: [Q, DQN], selector: {{type: apel, decay: 0.05}}}}
record: all
"""


@pytest.fixture(scope="module", params=[MINATAR, ATARI], ids=["minatar", "atari"])
def spec(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of an experiment."""
    path = tmp_path_factory.mktemp("breakout") / "breakout.yaml"
    path.write_text(request.param)
    return path


@pytest.fixture(scope="module")
def reference(spec: Path) -> Path:
    """All runs of an arm in one shard, in this process."""
    return play(spec, spec.parent / "reference", placement="local", shard_size=100)


def test_runs_end_with_the_episode_that_reaches_their_steps(spec: Path, reference: Path) -> None:
    """Not before, and no episode later; both learners had their turn."""
    budget = 150 if spec.read_text() == MINATAR else 130
    rows = episode_rows(reference)
    for _, run in rows.groupby(["arm", "run_index"]):
        total = run["length"].cumsum()
        assert total.iloc[-1] >= budget > (total.iloc[-2] if len(total) > 1 else 0)
    assert set(rows.loc[rows["arm"] == "APEL", "selected"]) == {0, 1}
    runs = pd.read_parquet(reference / "runs.parquet")
    assert (runs["steps"] >= budget).all()


@pytest.mark.parametrize(("shard_size", "streak"), [(1, 50), (2, 1)])
def test_shards_and_streaks_change_no_row(
    spec: Path, reference: Path, tmp_path: Path, shard_size: int, streak: int
) -> None:
    """However many runs share a call, and however often their hosts report."""
    execution = Execution(streak_episodes=streak)
    assert_same(reference, play(spec, tmp_path / "cut", placement="local", shard_size=shard_size, execution=execution))


@pytest.mark.ray
def test_actors_give_the_same_rows(ray_session: None, spec: Path, reference: Path, tmp_path: Path) -> None:
    """Entries with channels and signals travel between processes."""
    folder = play(spec, tmp_path / "ray", placement="actors", shard_size=100, arms=("APEL",))
    assert_same(reference, folder, "APEL")


def test_goes_on_from_the_checkpoint(spec: Path) -> None:
    """Memories of frames, stacks and budgets of steps: a shard that is lost ends with the rows of another one."""
    shard = Plan.of(load_experiment(str(spec), ["runs=2"])).only(["APEL"]).shards(num_cpus=1, shard_size=100)[-1]
    assert_goes_on(shard, 1)
