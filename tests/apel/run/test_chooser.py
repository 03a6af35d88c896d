"""A selector by itself, for a script."""

from __future__ import annotations

import math

import numpy as np
import pytest

import apel


def test_same_choices_as_an_ensemble() -> None:
    """With the seed and the performances of an ensemble it chooses as that does."""
    world = apel.make_world(apel.EnvironmentConfig("FrozenLake-v1"), run_seed=1)
    learners = [apel.LearnerConfig("q_learning"), apel.LearnerConfig("q_learning", {"learning_rate": 0.5})]
    selector = apel.Ssbas()
    records = list(apel.Ensemble(world, learners, selector, seed=5, num_episodes=60).run())
    chooser = apel.Chooser(selector, 2, seed=5, num_episodes=60)
    for record in records:
        assert chooser.select() == record.selected
        np.testing.assert_array_equal(chooser.probability, record.probability)
        chooser.observe(record.episode_return)
    with pytest.raises(ValueError, match="no choice left"):
        chooser.select()


def test_asked_twice() -> None:
    """Nothing is drawn before the answer is known, so that a script may ask again."""
    chooser, other = (apel.Chooser(apel.Uniform(), 5, seed=3) for _ in range(2))
    for _ in range(20):
        assert chooser.select() == chooser.select() == other.select()
        chooser.observe(1.0)
        other.observe(1.0)


def test_state_by_name() -> None:
    """What it reports is a copy: to write into it changes nothing."""
    chooser = apel.Chooser(apel.Apel(prior=(1.0, 4.0)), 2, seed=1)
    assert chooser.concentration.tolist() == [1.0, 4.0]
    chooser.concentration[:] = 100.0
    chosen = chooser.select()
    chooser.observe(-2.5)
    assert chooser.performance_estimate[chosen] == -2.5
    assert math.isnan(chooser.performance_estimate[1 - chosen])
    assert chooser.concentration.max() <= 4.0


class Beyond:
    """A rule that errs."""

    fields: dict[str, float] = {}  # noqa: RUF012 - as a user writes it

    def select(self, state: object, rng: object) -> int:
        return 2

    def observe(self, state: object, selected: int, performance: float) -> None:
        raise AssertionError


def test_refused() -> None:
    """What cannot be meant is said at once."""
    with pytest.raises(ValueError, match="found 0 learners"):
        apel.Chooser(apel.Apel(), 0, seed=1)
    with pytest.raises(ValueError, match="one per learner, 3"):
        apel.Chooser(apel.Apel(prior=(1.0, 1.0)), 3, seed=1)
    with pytest.raises(ValueError, match="found the learner 2, expected one from 0 to 1"):
        apel.Chooser(Beyond(), 2, seed=1).select()
    chooser = apel.Chooser(apel.Apel(), 2, seed=1)
    with pytest.raises(ValueError, match="performance of nobody"):
        chooser.observe(1.0)
    chooser.select()
    with pytest.raises(ValueError, match="found the performance nan, expected a finite number"):
        chooser.observe(math.nan)
