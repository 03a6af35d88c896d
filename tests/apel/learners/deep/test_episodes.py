"""Whole episodes in compiled code against the same bank one step at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from apel.building import make_bank
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import make_world
from apel.environments.batched import batched_environment
from apel.experience.representations import Representation
from apel.learners import LockstepBank
from apel.learners.base import Played, StreakLimit
from apel.run.opening import open_book
from apel.selectors import Fixed
from tests.apel.learners.deep.driving import assert_same_state

SEEDS = [1892932127, 501869158]
EPISODES = 6
CART_POLE = EnvironmentConfig("apel/CartPole-v0", {"max_steps": 30, "time_limit": "truncation"})
MAZE = EnvironmentConfig("apel/Maze-v0", {"size": 3, "distractors": [3], "max_steps": 30}, run_seed="maze_seed")
SMALL = {"network": {"hidden": [16]}, "learning_starts": 10}
LEARNERS: dict[str, dict[str, Any]] = {
    "dqn": {**SMALL, "batch_size": 8, "prioritized": {}},
    "acer": {**SMALL, "learning_starts": 2},
    "sac": {**SMALL, "batch_size": 8},
}


def bank_of(learner: str, environment: EnvironmentConfig, view: Representation) -> tuple[LockstepBank, list[Any]]:
    worlds = [make_world(environment, seed) for seed in SEEDS]
    config = LearnerConfig(learner, LEARNERS[learner], view)
    bank = make_bank([config] * 2, worlds, SEEDS, 0, "return", with_probability=True, freezes=True)
    assert isinstance(bank, LockstepBank)
    return bank, worlds


def played(bank: LockstepBank, worlds: list[Any]) -> Played:
    book = open_book(Fixed(), 1, EPISODES, None, SEEDS, [world.info for world in worlds])
    return bank.play([0, 1], book, Fixed(), 0, StreakLimit(EPISODES, 10**6), record=True)


@pytest.mark.parametrize("environment", [CART_POLE, MAZE], ids=lambda one: one.id)
@pytest.mark.parametrize("learner", LEARNERS)
def test_episodes_are_those_of_single_steps(learner: str, environment: EnvironmentConfig) -> None:
    """Rows, trajectories, and all that the learner is afterwards, bit for bit; with policies frozen within epochs."""
    view = Representation(exclude=("y",)) if environment is MAZE else Representation()
    (whole, worlds), (stepwise, _) = (bank_of(learner, environment, view) for _ in range(2))
    assert whole._player is not None
    stepwise._player = None
    found, expected = played(whole, worlds), played(stepwise, worlds)
    assert_same_state(whole.state(), stepwise.state())
    assert found.batch is not None
    assert expected.batch is not None
    assert len(found.episodes.run) == 2 * EPISODES
    by_episode = {(run, episode): one for run, episode, one in expected.batch.trajectories()}
    for run, episode, one in found.batch.trajectories():
        other = by_episode.pop((run, episode))
        for column in ("observation", "action", "reward", "probability"):
            np.testing.assert_array_equal(getattr(one, column), getattr(other, column), strict=True)
        assert one.terminated == other.terminated
    assert not by_episode


@pytest.mark.parametrize(
    ("environment", "view"),
    [
        (CART_POLE, Representation(exclude=(1,))),
        (CART_POLE, Representation(stack=2)),
        (EnvironmentConfig("CartPole-v1"), Representation()),
    ],
)
def test_what_is_seen_or_played_otherwise_is_played_step_by_step(
    environment: EnvironmentConfig, view: Representation
) -> None:
    """Compiled code shows the cart pole as it is, and knows no other environments."""
    bank, _ = bank_of("dqn", environment, view)
    assert bank._player is None


def test_another_sine_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where NumPy's trigonometry is not that of compiled code, there is no compiled cart pole."""
    monkeypatch.setattr("apel.environments.cartpole._has_same_trigonometry", lambda: False)
    worlds = [make_world(CART_POLE, seed) for seed in SEEDS]
    assert batched_environment(worlds).world(0) is None  # type: ignore[attr-defined]
