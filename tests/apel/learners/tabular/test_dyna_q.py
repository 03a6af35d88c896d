"""Dyna-Q (Sutton & Barto 2018, §8.2) as a learner of one run, and what its model is worth."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium import spaces

from apel.environments import Maze
from apel.experience.representations import Representation
from apel.learners import (
    CompiledBank,
    DynaQ,
    DynaQOptions,
    QLearning,
    QLearningOptions,
    TabularLearner,
    TabularMember,
    Transition,
)
from apel.learners.base import StreakLimit
from apel.run.criterion import Criterion
from apel.run.opening import open_book
from apel.selectors import Fixed
from tests.apel.splitmix import SplitMix64

SPACE, ACTIONS = spaces.Discrete(3), spaces.Discrete(2)


def step(state: int, action: int, reward: float, following: int, *, terminated: bool = False) -> Transition:
    return Transition(state, action, reward, following, terminated, not terminated, None)


def test_one_pair_is_replayed() -> None:
    """With one pair in the model all planning is of it: 1 + 3 updates with α = 1/2 towards 1 leave 1 − (1/2)⁴."""
    learner = DynaQ(SPACE, ACTIONS, 7, learning_rate=0.5, planning_steps=3)
    learner.learn(step(0, 1, 1.0, 1, terminated=True))
    assert learner.table[(0,)].tolist() == [0.0, 1 - 0.5**4]
    assert learner.steps == 1


def test_planning_carries_values_back() -> None:
    """The value of the end reaches the start within one episode by planning, as drawn from the learner's own stream.

    States 0 → 1 → end, α = 1, γ = 1: after (0, right, 0, 1) and (1, right, 1, end), Q(0, right) becomes 1 as soon as
    the first pair is planned.
    """
    learner = DynaQ(SPACE, ACTIONS, 7, learning_rate=1.0, planning_steps=10)
    plain = QLearning(SPACE, ACTIONS, 7, learning_rate=1.0)
    for one in (learner, plain):
        one.learn(step(0, 1, 0.0, 1))
        one.learn(step(1, 1, 1.0, 2, terminated=True))
    generator = SplitMix64.of_seed(7)
    drawn = [generator.integer(1) for _ in range(10)] + [generator.integer(2) for _ in range(10)]
    assert 0 in drawn[10:]
    assert learner.table[(0,)].tolist() == [0.0, 1.0]
    assert plain.table[(0,)].tolist() == [0.0, 0.0]
    assert int(learner.stream[0]) == generator.state


def test_model_keeps_what_happened_last() -> None:
    """A second outcome of the same action replaces the first, and takes no second place among the pairs."""
    learner = DynaQ(SPACE, ACTIONS, 7, learning_rate=1.0, planning_steps=1)
    learner.learn(step(0, 0, 5.0, 1, terminated=True))
    learner.learn(step(0, 0, -2.0, 1))
    model = {name: column.tolist() for name, column in learner.state()["model"].items()}
    assert model == {"keys": [[0]], "actions": [0], "rewards": [-2.0], "terminal": [False], "next_keys": [[1]]}
    assert learner.table[(0,)].tolist() == [-2.0, 0.0]


def test_restored_learner_goes_on_identically() -> None:
    """Table, model, the order of its pairs, and stream are carried over; the state is a copy."""
    learner, other = (DynaQ(SPACE, ACTIONS, seed, learning_rate=0.3, planning_steps=4) for seed in (7, 8))
    steps = [step(i * 5 % 3, i % 2, float(i % 4), (i * 2) % 3, terminated=i % 3 == 0) for i in range(12)]
    for one in steps[:6]:
        learner.learn(one)
    state = learner.state()
    for one in steps[6:]:
        learner.learn(one)
    other.learn(steps[3])
    other.restore(state)
    for one in steps[6:]:
        other.learn(one)
    np.testing.assert_equal(other.state()["model"], learner.state()["model"])
    assert other.stream.tolist() == learner.stream.tolist()
    assert {key: values.tolist() for key, values in other.table.items()} == {
        key: values.tolist() for key, values in learner.table.items()
    }


def test_planning_moves_no_other_stream() -> None:
    """With more planning a learner draws more from its own stream, and nothing from the environment's: every episode
    starts alike, distractor included.
    """
    model = Maze(maze_seed=3, size=4, distractors=(7,), max_steps=30).finite_model
    starts = []
    for options in (QLearningOptions(), DynaQOptions(planning_steps=1), DynaQOptions(planning_steps=9)):
        learners = [TabularLearner((TabularMember(options, Representation(), 5),))]
        bank = CompiledBank([model], [11], learners, "return", with_probability=False)
        book = open_book(Fixed(), 1, 30, None, [1], [{}])
        batch = bank.play([0], book, Fixed(), 0, StreakLimit(30, 10**5), record=True).batch
        assert batch is not None
        starts.append([int(trajectory.observation[0]) for _, _, trajectory in batch.trajectories()])
    assert starts[0] == starts[1] == starts[2]
    assert len(set(starts[0])) > 1


def test_learns_a_maze_in_far_fewer_episodes() -> None:
    """On 6 × 6 mazes Dyna-Q with 20 planning steps walks the shortest path (greedily, five times on end) after less
    than a third of Q-learning's episodes in each of ten mazes, and after less than a fifth of them in the mean.
    """
    models = [Maze(maze_seed=seed, size=6, max_steps=400).finite_model for seed in range(10)]
    times = []
    for options in (QLearningOptions(), DynaQOptions(planning_steps=20)):
        learners = [TabularLearner((TabularMember(options, Representation(), seed),)) for seed in range(10)]
        bank = CompiledBank(models, list(range(10)), learners, "return", with_probability=False)
        optimal = [model.info["optimal_length"] for model in models]
        criterion = Criterion("length", 5, below=1.0, evaluation="greedy")
        book = open_book(Fixed(), 1, 2000, criterion, [1] * 10, [{}] * 10)
        book.threshold[:] = np.array(optimal) + 0.5
        bank.play(list(range(10)), book, Fixed(), 0, StreakLimit(2000, 10**7), record=False)
        times.append(book.train_time)
    q, dyna = times
    assert (q > 0).all()
    assert (dyna > 0).all()
    assert (3 * dyna < q).all()
    assert 5 * dyna.mean() < q.mean()


def test_planning_steps_are_checked() -> None:
    """At least one: without planning it is Q-learning, which has a name of its own."""
    with pytest.raises(ValueError, match="planning_steps"):
        DynaQOptions(planning_steps=0)
