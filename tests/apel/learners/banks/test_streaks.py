"""How long a streak lasts, and that it lasts as long in both banks."""

from __future__ import annotations

import numpy as np
import pytest

from apel.building import make_bank
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import make_world
from apel.learners.banks.streaks import most_per_run, streak_goes_on
from apel.learners.base import StreakLimit
from apel.run.opening import open_book
from apel.run.state import FINISHED
from apel.selectors import Fixed

MAZE = EnvironmentConfig("apel/Maze-v0", {"size": 4, "max_steps": 20, "maze_seed": 3})


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
