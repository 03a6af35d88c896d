"""How long a streak lasts, and that it lasts as long in both banks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from apel import Ensemble
from apel.building import make_bank
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import make_world
from apel.experience.trajectory import Trajectory
from apel.learners.banks.streaks import most_per_run, streak_goes_on
from apel.learners.base import Performance, Played, StreakLimit
from apel.run.opening import open_book
from apel.run.state import FINISHED
from apel.selectors import Fixed

MAZE = EnvironmentConfig("apel/Maze-v0", {"size": 4, "max_steps": 20, "maze_seed": 3})
DISTRACTED = EnvironmentConfig("apel/Maze-v0", {"size": 4, "max_steps": 20, "maze_seed": 3, "distractors": [3]})
CLIFF = EnvironmentConfig("CliffWalking-v1", max_episode_steps=30)
CART_POLE = EnvironmentConfig("CartPole-v1")
COMPILED, PLAIN, DEEP = "q_learning", "apel.learners.tabular.q_learning:QLearning", "dqn"
TABULAR = [(environment, learner) for environment in (CLIFF, MAZE, DISTRACTED) for learner in (COMPILED, PLAIN, DEEP)]


def test_limits_are_shared_by_the_runs() -> None:
    """Episodes are counted per run, steps and bytes per host; each run may have at least one of each."""
    assert most_per_run(StreakLimit(7, 100, 1000), 3).tolist() == [7, 33, 333]
    assert most_per_run(StreakLimit(7, 2, 2), 3).tolist() == [7, 1, 1]


@pytest.mark.parametrize(
    ("streak", "goes_on"),
    [((4, 9, 99), True), ((5, 0, 0), False), ((0, 10, 0), False), ((0, 11, 0), False), ((0, 0, 100), False)],
)
def test_streak_ends_at_the_first_limit_that_is_reached(streak: tuple[int, int, int], goes_on: bool) -> None:
    """Whether it is compiled or not."""
    book = open_book(Fixed(), 2, 3, None, [1], [{}])
    for function in (streak_goes_on, streak_goes_on.py_func):  # type: ignore[attr-defined]
        assert function(book, 0, 0, np.array(streak), np.array([5, 10, 100])) == goes_on


def test_streak_ends_with_the_run_or_the_turn() -> None:
    """Where another learner is selected, or the run is over."""
    nothing, most = np.zeros(3, dtype=np.int64), np.ones(3, dtype=np.int64)
    for field, value in (("learner", 1), ("status", FINISHED)):
        book = open_book(Fixed(), 2, 3, None, [1], [{}])
        assert streak_goes_on(book, 0, 0, nothing, most)
        getattr(book, field)[0] = value
        assert not streak_goes_on(book, 0, 0, nothing, most)


@pytest.mark.parametrize("record", [True, False])
@pytest.mark.parametrize("learner", ["q_learning", "apel.learners.tabular.q_learning:QLearning"])
def test_bytes_bound_what_is_recorded(learner: str, record: bool) -> None:
    """A streak ends once its trajectories have so many bytes; where none are recorded it goes on."""
    world = make_world(MAZE, 1)
    bank = make_bank([LearnerConfig(learner)], [world], [1], 0, "return", with_probability=False)
    book = open_book(Fixed(), 1, 200, None, [1], [{}])
    played = bank.play([0], book, Fixed(), 0, StreakLimit(200, 10**6, 1000), record=record)
    steps, last = int(played.episodes.length.sum()), int(played.episodes.length[-1])
    if not record:
        assert len(played.episodes.run) == 200
        return
    # A step takes 2 bytes of state number and 1 each of action and reward in compiled code; elsewhere 8 of action and
    # 8 of reward, 32 of probabilities, and each episode one more state number.
    per_step, per_episode = (4, 0) if learner == "q_learning" else (2 + 8 + 8 + 32, 2)
    count = len(played.episodes.run)
    assert steps * per_step + count * per_episode >= 1000
    assert (steps - last) * per_step + (count - 1) * per_episode < 1000


def played(environment: EnvironmentConfig, learner: str, performance: Performance, *, record: bool = True) -> Played:
    """Five episodes of a run."""
    bank = make_bank([LearnerConfig(learner)], [make_world(environment, 1)], [1], 0, performance, with_probability=True)
    book = open_book(Fixed(), 1, 5, None, [1], [{}])
    return bank.play([0], book, Fixed(), 0, StreakLimit(5, 10**6), record=record)


class Seen:
    """What it is shown, and how much the actions change: a measure that wraps around in bytes."""

    def __init__(self) -> None:
        self.columns: list[tuple[Any, ...]] = []

    def __call__(self, trajectory: Trajectory) -> float:
        columns = trajectory.observation, trajectory.action, trajectory.reward
        self.columns += [(column.dtype, column.shape, column.tolist()) for column in columns]
        return -float(np.abs(np.diff(trajectory.action)).sum())


@pytest.mark.parametrize("record", [True, False])
@pytest.mark.parametrize(("environment", "learner"), [*TABULAR, (CART_POLE, DEEP)])
def test_a_users_measure_sees_the_same_whatever_plays(
    environment: EnvironmentConfig, learner: str, record: bool
) -> None:
    """Raw observations and actions that do not wrap around, as the plain loop shows them; so it says the same."""
    banks, plain = Seen(), Seen()
    answer = played(environment, learner, banks, record=record)
    ensemble = Ensemble(make_world(environment, 1), [LearnerConfig(learner)], Fixed(), 1, 5, performance=plain)
    assert [one.episode_return for one in ensemble.run()] == answer.episodes.episode_return.tolist()
    assert banks.columns == plain.columns
    observations, actions = zip(*[banks.columns[i : i + 2] for i in range(0, 15, 3)], strict=True)
    assert {kind for kind, _, _ in actions} == {np.dtype(np.int64)}
    features = {"CliffWalking-v1": (), "CartPole-v1": (4,)}.get(environment.name, (2 + (environment is DISTRACTED),))
    assert {shape[1:] for _, shape, _ in observations} == {features}
    assert answer.batch is None or answer.batch.observation.dtype == (
        np.float32 if environment is CART_POLE else np.uint16
    )


def spoiling(trajectory: Trajectory) -> float:
    """A discounted return, made in place, and more that is written."""
    rewards = trajectory.reward
    rewards *= 0.5 ** np.arange(len(rewards))
    assert trajectory.probability is not None
    for column in (trajectory.observation, trajectory.action, trajectory.probability):
        column[:] = 0
    return float(rewards.sum())


def discounted(trajectory: Trajectory) -> float:
    """The same, and nothing is written."""
    return float((trajectory.reward * 0.5 ** np.arange(len(trajectory))).sum())


@pytest.mark.parametrize(("environment", "learner"), [*TABULAR, (CART_POLE, DEEP)])
def test_what_a_users_measure_writes_reaches_nobody(environment: EnvironmentConfig, learner: str) -> None:
    """Neither the rows nor what others learn from."""
    one, other = played(environment, learner, spoiling), played(environment, learner, discounted)
    assert one.failures == other.failures == ()
    for found, expected in zip(one.episodes, other.episodes, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert one.batch is not None
    assert other.batch is not None
    for (_, _, found), (_, _, expected) in zip(one.batch.trajectories(), other.batch.trajectories(), strict=True):
        for name in ("observation", "action", "reward", "probability"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
