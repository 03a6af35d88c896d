from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from apel.configs import EnvironmentConfig, LearnerConfig
from apel.dynamics.finite_model import FiniteModel
from apel.environments import Maze, make_world
from apel.experience.representations import Representation, state_rows
from apel.experience.trajectory import Trajectory
from apel.learners import CompiledBank, Decay, QLearningOptions, Switch, TabularLearner, TabularMember
from apel.learners.base import Performance, StreakLimit
from apel.run.opening import open_book
from apel.run.selection import Selector
from apel.run.state import FINISHED, Book
from apel.selectors import Apel, Fixed, Ssbas
from tests.apel.models import frozen_lakes, lottery, mazes
from tests.apel.plain_q_learning import PlainEpisode, PlainQLearning, constant, decaying, switched
from tests.apel.plain_selector import PlainSelector
from tests.apel.rounds import assert_same_rows, make_banks, play_rounds

KEYS = [0x123456789ABCDEF0, 2**64 - 5, 17]
SEEDS = [99, 2**64 - 1, 4242]
UNLIMITED = StreakLimit(10**6, 10**5)


# What each case plays: models, options, the same exploration for the plain loop, representation of each run, episodes.
CASES = {
    "maze": (
        mazes,
        QLearningOptions(),
        constant(0.1),
        [Representation(), Representation(exclude=("distractor",)), Representation(exclude=("x",))],
        40,
    ),
    "maze-decay": (
        mazes,
        QLearningOptions(0.5, 0.9, Decay(start=0.9, end=0.05, steps=500)),
        decaying(0.9, 0.05, 500),
        [Representation(exclude=(2,))] * 3,
        40,
    ),
    "maze-switch": (
        mazes,
        QLearningOptions(0.25, 1.0, Switch(before=0.8, episode=20, after=0.01)),
        switched(0.8, 20, 0.01),
        [Representation()] * 3,
        40,
    ),
    "frozen-lake": (
        frozen_lakes,
        QLearningOptions(0.2, 0.97, 0.3),
        constant(0.3),
        [Representation()] * 3,
        300,
    ),
    "lottery": (
        lambda: [lottery(num_distractors=2)] * 3,
        QLearningOptions(1.0, 0.5, 0.2),
        constant(0.2),
        [Representation(), Representation(exclude=(1,)), Representation(exclude=("distractor_0", "distractor_1"))],
        200,
    ),
}


def make_bank(
    models: Sequence[FiniteModel],
    options: QLearningOptions,
    representations: Sequence[Representation],
    *,
    performance: Performance = "return",
    with_probability: bool = True,
) -> CompiledBank:
    learners = [tabular(options, view, seed) for view, seed in zip(representations, SEEDS, strict=True)]
    return CompiledBank(models, KEYS, learners, performance, with_probability=with_probability)


def tabular(options: QLearningOptions, representation: Representation, seed: int) -> TabularLearner:
    """A learner that is its only member."""
    return TabularLearner((TabularMember(options, representation, seed),))


def make_plain(
    models: Sequence[FiniteModel],
    options: QLearningOptions,
    exploration: Callable[[int, int], float],
    representations: Sequence[Representation],
) -> list[PlainQLearning]:
    return [
        PlainQLearning(
            model, key, seed, options.learning_rate, options.discount, exploration, view.visible(model.features)
        )
        for model, key, seed, view in zip(models, KEYS, SEEDS, representations, strict=True)
    ]


def alone(num_episodes: int, selector: Selector | None = None) -> Book:
    """The book of three runs of one learner."""
    return open_book(selector or Fixed(), 1, num_episodes, None, [1, 2, 3], [{}] * 3)


def assert_same_tables(
    bank: CompiledBank,
    plain: Sequence[PlainQLearning],
    models: Sequence[FiniteModel],
    representations: Sequence[Representation],
) -> None:
    """Every state's values, without any tolerance."""
    values = bank.state()["value"]
    for run, (model, view) in enumerate(zip(models, representations, strict=True)):
        rows = state_rows(view, model.features, model.feature_values())
        found = values[run][rows].tolist()
        assert found == [plain[run].values(state) for state in range(model.num_states)]


def as_trajectories(batch: Any) -> dict[tuple[int, int], Trajectory]:
    return {(run, episode): trajectory for run, episode, trajectory in batch.trajectories()}


def assert_same_episode(trajectory: Trajectory, played: PlainEpisode) -> None:
    assert trajectory.observation.tolist() == played.states
    assert trajectory.action.tolist() == played.actions
    assert trajectory.reward.tolist() == played.rewards
    assert trajectory.terminated == played.terminated
    assert trajectory.probability is not None
    np.testing.assert_allclose(trajectory.probability, played.probabilities, rtol=0, atol=1e-15)


@pytest.mark.parametrize("case", CASES)
def test_bank_equals_the_plain_loop(case: str) -> None:
    """Compiled streaks give the plain loop's episodes, step for step, and its Q-tables, value for value."""
    make_models, options, exploration, representations, num_episodes = CASES[case]
    models = make_models()
    bank, plain = make_bank(models, options, representations), make_plain(models, options, exploration, representations)
    book = alone(num_episodes)
    answer = bank.play([0, 1, 2], book, Fixed(), 0, UNLIMITED, record=True)
    assert answer.failures == ()
    assert book.status.tolist() == [FINISHED] * 3
    assert len(answer.episodes.run) == 3 * num_episodes
    trajectories = as_trajectories(answer.batch)
    rows = iter(zip(*(column.tolist() for column in answer.episodes), strict=True))
    for run in range(3):
        for episode in range(num_episodes):
            played = plain[run].play(episode)
            length = len(played.actions)
            measure = float(length)  # where there is no criterion
            assert next(rows) == (run, episode, length, played.total, played.total, measure, played.terminated)
            assert_same_episode(trajectories[run, episode], played)
    assert_same_tables(bank, plain, models, representations)
    assert bank.state()["steps"].tolist() == book.steps.tolist()


@pytest.mark.parametrize("case", CASES)
def test_learning_from_a_batch_equals_plain_updates(case: str) -> None:
    """A bank that learns from recorded episodes applies Eq. 2.8 step by step; then it acts on what it learned."""
    make_models, options, exploration, representations, _ = CASES[case]
    models = make_models()
    actor = make_bank(models, QLearningOptions(exploration=0.5), [Representation()] * 3)
    batch = actor.play([0, 1, 2], alone(20), Fixed(), 0, UNLIMITED, record=True).batch
    assert batch is not None
    bank, plain = make_bank(models, options, representations), make_plain(models, options, exploration, representations)
    assert bank.learn(batch) == ()
    for run, episode, trajectory in batch.trajectories():
        played = PlainEpisode(
            trajectory.observation.tolist(),
            trajectory.action.tolist(),
            trajectory.reward.tolist(),
            terminated=trajectory.terminated,
        )
        plain[run].learn_episode(played, episode)
    assert_same_tables(bank, plain, models, representations)
    # Its own clocks have moved too: it goes on at episode 20 with an ε of so many steps.
    book = alone(30)
    book.episode[:] = 20
    trajectories = as_trajectories(bank.play([0, 1, 2], book, Fixed(), 0, UNLIMITED, record=True).batch)
    for (run, episode), trajectory in trajectories.items():
        assert_same_episode(trajectory, plain[run].play(episode))


@pytest.mark.parametrize("performance", ["return", "negative_length"])
@pytest.mark.parametrize("record", [False, True])
def test_fallback_path_equals_compiled_path(performance: Any, record: bool) -> None:
    """A performance given as a function, or a selector of plain functions, gives the same rows, tables and batches."""
    make_models, options, _, representations, num_episodes = CASES["maze-decay"]
    as_function: Callable[[Trajectory], float] = {
        "return": lambda trajectory: trajectory.undiscounted_return,
        "negative_length": lambda trajectory: -len(trajectory),
    }[performance]
    results = []
    for measure, selector in (
        (performance, Apel()),
        (as_function, Apel()),
        (performance, PlainSelector(Apel())),
        (as_function, PlainSelector(Apel())),
    ):
        bank = make_bank(make_models(), options, representations, performance=measure)
        book = alone(num_episodes, selector)
        results.append((bank.play([0, 1, 2], book, selector, 0, UNLIMITED, record=record), bank.state(), book))
    answer, state, book = results[0]
    for other_answer, other_state, other_book in results[1:]:
        for one, two in zip(answer.episodes, other_answer.episodes, strict=True):
            np.testing.assert_array_equal(one, two)
        for name in state:
            np.testing.assert_array_equal(state[name], other_state[name])
        for one, two in zip(book, other_book, strict=True):
            np.testing.assert_array_equal(one, two)
        assert (answer.batch is not None) == (other_answer.batch is not None) == record
        if record:
            one, two = as_trajectories(answer.batch), as_trajectories(other_answer.batch)
            assert one.keys() == two.keys()
            for key in one:
                np.testing.assert_array_equal(one[key].observation, two[key].observation)
                np.testing.assert_array_equal(one[key].reward, two[key].reward)
                np.testing.assert_array_equal(one[key].probability, two[key].probability)


def test_performance_is_the_named_one() -> None:
    """What the selector compares is the return, or minus the length."""
    for performance in ("return", "negative_length"):
        bank = make_bank(mazes(), QLearningOptions(), [Representation()] * 3, performance=performance)
        episodes = bank.play([0, 1, 2], alone(5), Fixed(), 0, UNLIMITED, record=False).episodes
        expected = episodes.episode_return if performance == "return" else -episodes.length.astype(np.float64)
        np.testing.assert_array_equal(episodes.performance, expected)
        assert set(episodes.length.tolist()) != {80}


@pytest.mark.parametrize(
    ("limit", "episodes", "steps_at_most"),
    [(StreakLimit(3, 10**6), 3, None), (StreakLimit(10**6, 3 * 100), None, 100 + 80)],
)
def test_streak_limits_bound_a_streak(limit: StreakLimit, episodes: int | None, steps_at_most: int | None) -> None:
    """A streak ends after so many episodes per run, or so many steps per host; the episode under way is finished."""
    bank = make_bank(mazes(), QLearningOptions(), [Representation()] * 3)
    answer = bank.play([0, 1, 2], alone(1000), Fixed(), 0, limit, record=True)
    counts = np.bincount(answer.episodes.run, minlength=3)
    steps = np.bincount(answer.episodes.run, weights=answer.episodes.length, minlength=3)
    if episodes is not None:
        assert counts.tolist() == [episodes] * 3
    if steps_at_most is not None:
        last = [answer.episodes.length[answer.episodes.run == run][-1] for run in range(3)]
        assert all(100 <= one < steps_at_most for one in steps)
        assert all(one - length < 100 for one, length in zip(steps, last, strict=True))


@pytest.mark.parametrize("selector", [Apel(decay=0.05), Ssbas()], ids=["apel", "ssbas"])
def test_streak_limits_change_no_result(selector: Selector) -> None:
    """Streaks of 1, 5 or 50 episodes give the same rows and tables, in different numbers of rounds."""
    learners = [
        LearnerConfig("q_learning", {"exploration": Decay(start=0.9, end=0.05, steps=800)}),
        LearnerConfig("q_learning", {}, Representation(exclude=("distractor",))),
        LearnerConfig("q_learning", {"learning_rate": 0.5}, Representation(exclude=("x",))),
    ]
    config = EnvironmentConfig("apel/Maze-v0", {"size": 4, "distractors": [3], "max_steps": 60}, run_seed="maze_seed")
    seeds = [5, 6]
    worlds = [make_world(config, seed) for seed in seeds]
    results = []
    for limit in (StreakLimit(1, 10**5), StreakLimit(5, 10**5), StreakLimit(50, 10**5), StreakLimit(50, 200)):
        banks = make_banks(learners, worlds, seeds)
        played = play_rounds(banks, worlds, seeds, selector, 100, limit=limit)
        results.append((played, [bank.state() for bank in banks]))
    first, states = results[0]
    for played, others in results[1:]:
        assert_same_rows(played.rows, first.rows)
        for one, two in zip(states, others, strict=True):
            for name in one:
                np.testing.assert_array_equal(one[name], two[name])
    assert results[0][0].rounds > results[1][0].rounds > 1
    assert {row[1] for row in first.rows[0]} == {0, 1, 2}


def test_batch_without_probability_and_without_batch() -> None:
    """μ is recorded only where it is asked for, trajectories only where somebody learns from them."""
    bank = make_bank(mazes(), QLearningOptions(), [Representation()] * 3, with_probability=False)
    answer = bank.play([0, 1, 2], alone(10), Fixed(), 0, StreakLimit(2, 10**5), record=True)
    assert answer.batch is not None
    assert answer.batch.probability is None
    assert bank.play([1], alone(10), Fixed(), 0, StreakLimit(2, 10**5), record=False).batch is None


def test_playing_some_runs_leaves_the_others_alone() -> None:
    """A run that is not ordered does not change, and the ordered one plays as if it were alone."""
    together = make_bank(mazes(), QLearningOptions(), [Representation()] * 3)
    apart = make_bank(mazes(), QLearningOptions(), [Representation()] * 3)
    book, other_book = alone(20), alone(20)
    together.play([0, 1, 2], book, Fixed(), 0, UNLIMITED, record=False)
    answer = apart.play([1], other_book, Fixed(), 0, UNLIMITED, record=False)
    assert set(answer.episodes.run.tolist()) == {1}
    one, two = together.state(), apart.state()
    np.testing.assert_array_equal(one["value"][1], two["value"][1])
    assert not two["value"][[0, 2]].any()
    assert (two["steps"][[0, 2]] == 0).all()


def test_restored_bank_goes_on_identically() -> None:
    """State and book carried over to a new bank give the same episodes and tables from there on."""
    make_models, options, _, representations, _ = CASES["maze-decay"]

    def go_on(bank: CompiledBank, book: Book) -> list[list[Any]]:
        answer = bank.play([0, 1, 2], book, Fixed(), 0, UNLIMITED, record=False)
        return [column.tolist() for column in answer.episodes]

    bank, book = make_bank(make_models(), options, representations), alone(60)
    bank.play([0, 1, 2], book, Fixed(), 0, StreakLimit(25, 10**6), record=False)
    state = bank.state()
    other, other_book = make_bank(make_models(), options, representations), alone(60)
    other.play([0, 2], alone(60), Fixed(), 0, StreakLimit(3, 10**6), record=False)
    other.restore(state)
    for column, values in zip(other_book, book, strict=True):
        if isinstance(column, np.ndarray):
            column[...] = values
    assert go_on(other, other_book) == go_on(bank, book)
    np.testing.assert_array_equal(other.state()["value"], bank.state()["value"])
    assert not np.array_equal(state["value"], bank.state()["value"])  # a snapshot, not a view


def test_learns_a_small_maze() -> None:
    """On a 4 × 4 maze without distractors the greedy path is optimal after 300 episodes."""
    model = Maze(maze_seed=4, size=4, max_steps=200).finite_model
    learners = [tabular(QLearningOptions(), Representation(), seed) for seed in SEEDS]
    bank = CompiledBank([model] * 3, KEYS, learners, "return", with_probability=False)
    bank.play([0, 1, 2], alone(300), Fixed(), 0, UNLIMITED, record=False)
    for values in bank.state()["value"]:
        cell, steps, reached = int(model.start_cell[0]), 0, False
        while not reached and steps < 50:
            action = int(np.argmax(values[cell]))
            reached = bool(model.terminal[cell, action, 0])
            cell = int(model.next_cell[cell, action, 0])
            steps += 1
        assert steps == model.info["optimal_length"]


def test_many_states_are_numbered_without_loss() -> None:
    """More than 65535 states do not fit 16 bits: the recorded observations are wider, and right."""
    model = Maze(maze_seed=1, size=10, distractors=(1000,), max_steps=30).finite_model
    learners = [tabular(QLearningOptions(), Representation(exclude=(2,)), SEEDS[0])]
    bank = CompiledBank([model], KEYS[:1], learners, "return", with_probability=True)
    plain = PlainQLearning(model, KEYS[0], SEEDS[0], 0.1, 1.0, constant(0.1), [0, 1])
    book = open_book(Fixed(), 1, 20, None, [1], [{}])
    batch = bank.play([0], book, Fixed(), 0, UNLIMITED, record=True).batch
    assert batch is not None
    assert int(batch.observation.max()) > 65_535
    for _, episode, trajectory in batch.trajectories():
        assert_same_episode(trajectory, plain.play(episode))
