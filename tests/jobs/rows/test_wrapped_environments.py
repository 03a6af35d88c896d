"""Rewards that users change by a subclass or a wrapper are those of the rows, whoever plays, and `apel validate` says
how it will be played.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.command_line import printed
from tests.same_rows import episode_rows, play

USERS = """
import gymnasium
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
import apel  # registers the mazes


class CostlyLake(FrozenLakeEnv):
    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward - 0.01, terminated, truncated, info


class Cost(gymnasium.Wrapper):
    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward - 0.01, terminated, truncated, info


class Scaled(gymnasium.RewardWrapper):
    def reward(self, reward):
        return 10.0 * reward


def wrapped(**options):
    return Cost(gymnasium.make("FrozenLake-v1", **options))


def maze(**options):
    return Scaled(gymnasium.make("apel/Maze-v0", **options))


def pole(**options):
    return Scaled(gymnasium.make("apel/CartPole-v0", **options))
"""
DEEP = "{type: dqn, network: {hidden: [4]}, head_hidden: [4], learning_starts: 1000}"
LAKE = """
name: costly-lake
runs: 2
episodes: 20
environment: {id: "%s", options: {is_slippery: false}, max_episode_steps: 30}
learners: {Q: {type: q_learning}}
arms: {Q: {learners: [Q]}}
record: all
"""
SCALED = """
name: scaled
runs: 2
episodes: 10
environment: {id: "%s", options: {%s}}
learners: {L: %s}
arms: {L: {learners: [L]}}
record: all
"""


@pytest.fixture(autouse=True)
def _users_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "users_wrappers.py").write_text(USERS)
    monkeypatch.syspath_prepend(str(tmp_path))


def rows(tmp_path: Path, spec: str, capsys: pytest.CaptureFixture[str]) -> tuple[list[tuple[float, int]], str]:
    """Return and length of every episode, and what `apel validate` says."""
    file = tmp_path / "spec.yaml"
    file.write_text(spec)
    said = printed(capsys, "validate", str(file))
    table = episode_rows(play(file, tmp_path / "results", placement="local"))
    return list(zip(table["return"].tolist(), table["length"].tolist(), strict=True)), said


@pytest.mark.parametrize(
    ("id_", "reason"), [("CostlyLake", "CostlyLake overrides step"), ("wrapped", "wrapped by Cost")]
)
def test_every_step_costs(id_: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """.01 a step: −.01 n where the goal is missed in n steps, 1 − .01 n where it is reached."""
    found, said = rows(tmp_path, LAKE % f"users_wrappers:{id_}", capsys)
    assert len(found) == 40
    for total, length in found:
        assert min(abs(total + 0.01 * length), abs(total - 1 + 0.01 * length)) < 1e-9
    assert f"environment users_wrappers:{id_}: step by step: {reason}" in said
    assert "learner Q: run by run" in said


@pytest.mark.parametrize(
    ("id_", "options", "learner", "per_step"),
    [
        ("maze", "size: 4, max_steps: 50", "{type: q_learning}", -1.0),
        ("maze", "size: 4, max_steps: 50", DEEP, -1.0),
        ("pole", "", DEEP, 10.0),
    ],
)
def test_every_reward_is_scaled(
    id_: str, options: str, learner: str, per_step: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten times −.1 for each step in the maze (and 10 instead of the last −1 at its goal), ten times 1 for a pole."""
    found, said = rows(tmp_path, SCALED % (f"users_wrappers:{id_}", options, learner), capsys)
    assert len(found) == 20
    for total, length in found:
        at_goal = per_step * length + 11.0
        possible = [per_step * length] if id_ == "pole" else [at_goal] if length < 50 else [at_goal, -50.0]
        assert any(total == pytest.approx(one) for one in possible)
    assert "step by step: wrapped by Scaled" in said


@pytest.mark.parametrize(
    ("environment", "learner", "expected"),
    [
        (
            "{id: FrozenLake-v1}",
            "{type: q_learning}",
            ["environment FrozenLake-v1: played by its tables (Gymnasium's FrozenLakeEnv, unchanged)", "compiled, on"],
        ),
        (
            "{id: Taxi-v4, options: {fickle_passenger: true}}",
            "{type: q_learning}",
            ["environment Taxi-v4: step by step: its option fickle_passenger is not in its tables", "run by run"],
        ),
        (
            "{id: apel/CartPole-v0}",
            DEEP,
            ["environment apel/CartPole-v0: all runs of a shard at once (CartPole, unchanged)", "all runs of a shard"],
        ),
        ("{id: CartPole-v1}", DEEP, ["environment CartPole-v1: step by step: it has no tables"]),
    ],
)
def test_validate_says_how_it_will_be_played(
    environment: str, learner: str, expected: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By tables, by arrays, or step by step, and why."""
    spec = (SCALED % ("x", "", learner)).replace('{id: "x", options: {}}', environment)
    (tmp_path / "spec.yaml").write_text(spec)
    said = printed(capsys, "validate", str(tmp_path / "spec.yaml"))
    assert all(part in said for part in expected), said
