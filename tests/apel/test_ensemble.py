from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from apel.configs import EnvironmentConfig, LearnerConfig
from apel.ensemble import Ensemble
from apel.environments import World, make_world
from apel.experience.representations import Bins, Representation
from apel.experience.trajectory import Trajectory
from apel.learners import CompiledBank, Decay, LockstepBank, QLearning, Switch
from apel.learners.base import StreakLimit
from apel.run.criterion import Criterion, Threshold
from apel.run.selection import Selector
from apel.selectors import Apel, Fixed, Incumbent, Ssbas, Uniform
from tests.apel import user_learner
from tests.apel.plain_selector import PlainSelector
from tests.apel.rounds import assert_same_rows, ensemble_rows, make_banks, play_rounds

HERE = "tests.apel.user_learner"
SEEDS = [1892932127, 501869158]
CRITERION = Criterion("length", 5, below=Threshold(2.0, "optimal_length"))

MAZE = EnvironmentConfig("apel/Maze-v0", {"size": 4, "distractors": [3], "max_steps": 60}, run_seed="maze_seed")
FROZEN_LAKE = EnvironmentConfig("FrozenLake-v1", max_episode_steps=50)
CART_POLE = EnvironmentConfig("CartPole-v1", max_episode_steps=40)

DECAYING = LearnerConfig("q_learning", {"exploration": Decay(start=0.9, end=0.02, steps=600)})
SWITCHING = LearnerConfig("q_learning", {"exploration": Switch(before=1.0, episode=20, after=0.05)})
REDUCED = LearnerConfig("q_learning", {}, Representation(exclude=("distractor",)))
FAST = LearnerConfig("q_learning", {"learning_rate": 0.5, "discount": 0.95})
USERS = LearnerConfig(f"{HERE}:AverageReward", {"explore_every": 2})
BINS = Representation(bins=(Bins(-2.4, 2.4, 3), Bins(-3, 3, 4), Bins(-0.21, 0.21, 6), Bins(-3.5, 3.5, 4)))
IN_BINS = LearnerConfig("q_learning", {"exploration": 0.2}, BINS)

SELECTORS: list[Selector] = [Apel(decay=0.05), Ssbas(), PlainSelector(Apel(decay=0.05)), Uniform(), Incumbent(0.2, 0.3)]
selectors = pytest.mark.parametrize("selector", SELECTORS, ids=["apel", "ssbas", "plain apel", "uniform", "incumbent"])


def worlds_of(config: EnvironmentConfig) -> list[World]:
    return [make_world(config, seed) for seed in SEEDS]


@selectors
@pytest.mark.parametrize(
    ("config", "learners", "kinds"),
    [
        (MAZE, [DECAYING, REDUCED], [CompiledBank] * 2),
        (MAZE, [REDUCED, SWITCHING, FAST], [CompiledBank] * 3),
        (FROZEN_LAKE, [DECAYING, FAST], [CompiledBank] * 2),
        (FROZEN_LAKE, [FAST, USERS], [CompiledBank, LockstepBank]),
        (MAZE, [USERS, REDUCED], [LockstepBank, CompiledBank]),
        (CART_POLE, [IN_BINS, USERS], [LockstepBank] * 2),
    ],
    ids=["maze", "maze of three", "frozen lake", "frozen lake and user", "maze and user", "cart pole and user"],
)
def test_ensemble_equals_banks(
    config: EnvironmentConfig, learners: list[LearnerConfig], kinds: list[type], selector: Selector
) -> None:
    """The plain loop of Algorithm 5 and banks in streaks give the same rows: selected, return, length, and header."""
    worlds, num_episodes = worlds_of(config), 60
    rows, times = ensemble_rows(learners, worlds, SEEDS, selector, num_episodes)
    banks = make_banks(learners, worlds_of(config), SEEDS, with_probability=True)
    assert [type(bank) for bank in banks] == kinds
    played = play_rounds(banks, worlds, SEEDS, selector, num_episodes)
    assert played.failures == []
    assert_same_rows(played.rows, rows)
    assert [len(rows[run]) for run in (0, 1)] == [num_episodes] * 2
    assert {row[1] for row in rows[0]} == set(range(len(learners)))
    assert times == [None, None]


@pytest.mark.parametrize("performance", ["return", "negative_length", f"{HERE}:actions_taken"])
@pytest.mark.parametrize("selector", SELECTORS[:2], ids=["apel", "ssbas"])
def test_every_performance_measure_gives_the_same_rows(selector: Selector, performance: str) -> None:
    """Named measures and a user's function mean the same in the plain loop and in banks."""
    worlds, learners = worlds_of(MAZE), [DECAYING, REDUCED]
    rows, _ = ensemble_rows(learners, worlds, SEEDS, selector, 40, performance=performance)
    banks = make_banks(learners, worlds, SEEDS, performance=performance)
    assert_same_rows(play_rounds(banks, worlds, SEEDS, selector, 40).rows, rows)


def test_measures_differ() -> None:
    """The estimate is the chosen measure of the last episode, so that the last test compares three different things."""
    worlds = worlds_of(MAZE)
    estimates = []
    for performance in ("return", "negative_length", f"{HERE}:actions_taken"):
        ensemble = Ensemble(worlds[0], [REDUCED], Fixed(), SEEDS[0], 2, performance=performance)
        first, second = ensemble.run()
        assert np.isnan(first.performance_estimate).all()
        if performance == "return":
            assert second.performance_estimate.tolist() == [first.episode_return]
        if performance == "negative_length":
            assert second.performance_estimate.tolist() == [-first.length]
        estimates.append(second.performance_estimate[0])
    assert len(set(estimates)) == 3


@pytest.mark.parametrize("selector", SELECTORS[:3], ids=["apel", "ssbas", "plain apel"])
def test_train_time_is_the_first_episode_of_the_criterion(selector: Selector) -> None:
    """A run stops at the first window whose mean is below the threshold, in the loop as in banks, and not before."""
    worlds, learners = worlds_of(MAZE), [DECAYING, REDUCED]
    rows, times = ensemble_rows(learners, worlds, SEEDS, selector, 400, criterion=CRITERION)
    for run, world in enumerate(worlds):
        lengths, bound = [row[3] for row in rows[run]], 2 * world.info["optimal_length"]
        expected = next(e + 1 for e in range(4, len(lengths)) if sum(lengths[e - 4 : e + 1]) / 5 < bound)
        assert times[run] == expected == len(lengths)
    played = play_rounds(make_banks(learners, worlds, SEEDS), worlds, SEEDS, selector, 400, criterion=CRITERION)
    assert_same_rows(played.rows, rows)
    assert played.book.train_time.tolist() == times


def test_run_that_never_meets_its_criterion_has_no_train_time() -> None:
    """At the cap the run ends without a train time."""
    ensemble = Ensemble(worlds_of(MAZE)[0], [REDUCED], Fixed(), 1, 12, criterion=Criterion("length", 2, below=1.0))
    assert len(list(ensemble.run())) == 12
    assert ensemble.train_time is None
    assert list(ensemble.run()) == []


def test_rows_do_not_depend_on_the_other_runs() -> None:
    """A run's rows are its own, whoever else is in the shard and in which order."""
    learners = [DECAYING, REDUCED]
    rows, _ = ensemble_rows(learners, worlds_of(MAZE), SEEDS, Apel(), 30)
    for order in ([1, 0], [1]):
        seeds = [SEEDS[i] for i in order]
        worlds = [make_world(MAZE, seed) for seed in seeds]
        played = play_rounds(make_banks(learners, worlds, seeds), worlds, seeds, Apel(), 30)
        assert_same_rows(played.rows, {position: rows[i] for position, i in enumerate(order)})


def test_adding_a_learner_moves_no_other_stream() -> None:
    """Learner 0 plays its episodes alike, alone or with a second learner that is never selected."""
    alone, _ = ensemble_rows([FAST], worlds_of(FROZEN_LAKE), SEEDS, Fixed(), 40)
    accompanied, _ = ensemble_rows([FAST, DECAYING], worlds_of(FROZEN_LAKE), SEEDS, Fixed(), 40)
    for run in (0, 1):
        assert [row[:4] for row in accompanied[run]] == [row[:4] for row in alone[run]]


def test_same_seed_gives_the_same_run() -> None:
    """Everything random follows from the seed; another seed gives another run."""
    learners = [DECAYING, REDUCED]
    one, _ = ensemble_rows(learners, worlds_of(MAZE), SEEDS, Apel(), 20)
    two, _ = ensemble_rows(learners, worlds_of(MAZE), SEEDS, Apel(), 20)
    assert_same_rows(one, two)
    assert one[0] != one[1]


def test_single_learner_is_q_learning() -> None:
    """An ensemble of one is that learner: APEL selects it with probability 1, and its table is the bank's."""
    world = worlds_of(FROZEN_LAKE)[0]
    ensemble = Ensemble(world, [FAST], Apel(), SEEDS[0], 50)
    records = list(ensemble.run())
    assert [record.episode for record in records] == list(range(50))
    assert all(record.selected == 0 and record.probability.tolist() == [1.0] for record in records)
    (bank,) = make_banks([FAST], [world], SEEDS[:1])
    play_rounds([bank], [world], SEEDS[:1], Apel(), 50)
    learner = ensemble.learners[0]
    assert isinstance(learner, QLearning)
    assert bank.state()["value"][0].tolist() == [learner.table[(state,)].tolist() for state in range(16)]


def test_all_learners_see_every_transition() -> None:
    """Acting or not, each learner gets the same steps in the same order, in its own view, with μ of whoever acted."""
    world = worlds_of(MAZE)[0]
    recorders = [
        LearnerConfig(f"{HERE}:Recorder"),
        LearnerConfig(f"{HERE}:Recorder", {}, Representation(exclude=("y",))),
    ]
    ensemble = Ensemble(world, [*recorders, FAST], Apel(), 3, 30)
    records = list(ensemble.run())
    whole, reduced, q = ensemble.learners
    assert isinstance(whole, user_learner.Recorder)
    assert isinstance(reduced, user_learner.Recorder)
    assert isinstance(q, QLearning)
    assert len(whole.seen) == len(reduced.seen) == q.steps == sum(record.length for record in records)
    assert whole.episodes == reduced.episodes == q.episode == 30
    for one, other in zip(whole.seen, reduced.seen, strict=True):
        assert other.observation.tolist() == one.observation[[0, 2]].tolist()
        assert other.next_observation.tolist() == one.next_observation[[0, 2]].tolist()
        assert one[1:3] == other[1:3]
        assert one[4:6] == other[4:6]
    ends = np.cumsum([record.length for record in records])
    assert [i + 1 for i, step in enumerate(whole.seen) if step.terminated or step.truncated] == ends.tolist()
    assert not any(step.terminated and step.truncated for step in whole.seen)
    starts = [0, *ends[:-1].tolist()]
    for record, start in zip(records, starts, strict=True):
        steps = whole.seen[start : start + record.length]
        assert sum(step.reward for step in steps) == pytest.approx(record.episode_return)
        assert all((step.probability is None) == (record.selected != 2) for step in steps)


def test_learner_is_made_with_its_view_and_seed() -> None:
    """A user's learner receives the reduced space and a 64-bit seed of its own."""
    recorder = LearnerConfig(f"{HERE}:Recorder", {}, Representation(exclude=("x", "distractor")))
    ensemble = Ensemble(worlds_of(MAZE)[0], [recorder, recorder], Apel(), 3, 1)
    first, second = ensemble.learners
    assert isinstance(first, user_learner.Recorder)
    assert isinstance(second, user_learner.Recorder)
    assert first.space.nvec.tolist() == [4]
    assert first.seed != second.seed
    assert 0 <= first.seed < 2**64


def test_truncation_is_told_from_termination() -> None:
    """A learner sees which of the two ended the episode, also on episodes of others."""
    recorders = [LearnerConfig(f"{HERE}:Recorder")] * 2
    ensemble = Ensemble(worlds_of(FROZEN_LAKE)[0], recorders, Uniform(), 8, 40)
    records = list(ensemble.run())
    one, other = ensemble.learners
    assert isinstance(one, user_learner.Recorder)
    assert isinstance(other, user_learner.Recorder)
    ends = [(step.terminated, step.truncated) for step in one.seen if step.terminated or step.truncated]
    assert ends == [(step.terminated, step.truncated) for step in other.seen if step.terminated or step.truncated]
    assert len(ends) == 40
    assert all(truncated == (record.length == 50) for record, (_, truncated) in zip(records, ends, strict=True))


def test_recorded_header_is_that_of_the_selection() -> None:
    """A record's probability, concentration and estimate are those with which its learner was selected."""
    records = list(Ensemble(worlds_of(MAZE)[0], [DECAYING, REDUCED], Apel(decay=0.1), 3, 40).run())
    last = np.full(2, np.nan)
    concentration = np.ones(2)
    for record in records:
        np.testing.assert_array_equal(record.performance_estimate, last)
        np.testing.assert_allclose(record.concentration, concentration)
        assert record.probability.sum() == pytest.approx(1.0)
        last[record.selected] = record.episode_return
        if last[record.selected] > last[1 - record.selected]:
            concentration[record.selected] += 1
        concentration = np.maximum(concentration * 0.9, 1.0)


def test_performance_that_is_no_number_is_an_error() -> None:
    """NaN is refused where it arises, and the run does not go on as if nothing had been."""
    ensemble = Ensemble(worlds_of(MAZE)[0], [REDUCED], Apel(), 1, 5, performance=f"{HERE}:not_a_number")
    with pytest.raises(ValueError, match="found the performance nan, expected a finite number"):
        ensemble.run_episode()


def test_performance_that_is_no_number_fails_the_run_in_a_bank() -> None:
    """In a shard the failure names run and episode."""
    worlds = worlds_of(MAZE)
    banks = make_banks([REDUCED], worlds, SEEDS, performance=f"{HERE}:not_a_number")
    played = play_rounds(banks, worlds, SEEDS, Apel(), 5)
    found = [(failure.run, failure.episode, failure.error) for failure in played.failures]
    assert found == [(run, 0, "found the performance nan, expected a finite number") for run in (0, 1)]
    assert played.book.episode.tolist() == [0, 0]


def test_learner_that_is_not_off_policy_is_refused() -> None:
    """A learner that may not learn from others cannot be a member, not even alone."""
    with pytest.raises(ValueError, match="OnPolicy is not off-policy: it cannot learn from the trajectories of other"):
        Ensemble(worlds_of(MAZE)[0], [FAST, LearnerConfig(f"{HERE}:OnPolicy")], Apel(), 1, 5)


def test_failing_learner_ends_its_run_alone() -> None:
    """What a user's learner raises is reported with run and episode; the shard's other runs go on to their end."""
    worlds = worlds_of(MAZE)
    config = LearnerConfig(f"{HERE}:Refusing")
    fine = LearnerConfig(f"{HERE}:AverageReward")
    for learners in ([config], [config, fine], [fine, config]):
        banks = make_banks(learners, worlds, SEEDS)
        if len(learners) > 1:
            # Run 1 is played with a learner that does not fail.
            broken = learners.index(config)
            lists = [bank.learner.learners for bank in banks]  # type: ignore[attr-defined]
            lists[broken][1] = lists[1 - broken][1]
        played = play_rounds(banks, worlds, SEEDS, Uniform(), 40)
        failed = {0} if len(learners) > 1 else {0, 1}
        assert {failure.run for failure in played.failures} == failed
        assert all(failure.error == "ArithmeticError: a hundred is enough" for failure in played.failures)
        if len(learners) > 1:
            assert len(played.rows[1]) == 40
            assert len(played.rows[0]) < 40


@pytest.mark.parametrize("config", [CART_POLE, FROZEN_LAKE], ids=["cart pole", "frozen lake"])
def test_generic_bank_is_restored_with_its_learners(config: EnvironmentConfig) -> None:
    """A generic bank's state carries every run's learner over to another bank."""
    worlds, learners = worlds_of(config), [USERS]
    whole = play_rounds(make_banks(learners, worlds, SEEDS), worlds, SEEDS, Fixed(), 20)
    (first,) = make_banks(learners, worlds, SEEDS)
    start = play_rounds([first], worlds, SEEDS, Fixed(), 10)
    (second,) = make_banks(learners, worlds, SEEDS)
    second.restore(first.state())
    book = start.book._replace(num_episodes=20)
    book.status[:] = 0
    rest = second.play([0, 1], book, Fixed(), 0, StreakLimit(100, 10**6), record=False).episodes
    for run in (0, 1):
        expected = [(row[0], row[2], row[3]) for row in whole.rows[run][10:]]
        mine = rest.run == run
        columns = (rest.episode, rest.episode_return, rest.length)
        assert list(zip(*(column[mine].tolist() for column in columns), strict=True)) == expected


def test_generic_bank_equals_tabular_bank() -> None:
    """The plain Q-learner by import path, in the generic bank, gives the rows of the compiled bank."""
    worlds = worlds_of(MAZE)
    shipped = [DECAYING, REDUCED]
    plain = [LearnerConfig("apel.learners.tabular.q_learning:QLearning", c.options, c.representation) for c in shipped]
    results = []
    for learners, kind in ((shipped, CompiledBank), (plain, LockstepBank)):
        banks = make_banks(learners, worlds, SEEDS)
        assert all(isinstance(bank, kind) for bank in banks)
        results.append(play_rounds(banks, worlds, SEEDS, Apel(), 50).rows)
    assert_same_rows(*results)


def test_trajectory_of_a_finite_environment_holds_state_numbers() -> None:
    """Member and compiled bank record the same trajectory: state numbers, not vectors, with the same μ."""
    world, recorded = worlds_of(MAZE)[0], {}
    for path in ("q_learning", "apel.learners.tabular.q_learning:QLearning"):
        (bank,) = make_banks([LearnerConfig(path)], [world], SEEDS[:1], with_probability=True)
        book = Ensemble(world, [FAST], Fixed(), SEEDS[0], 5)._book
        batch = bank.play([0], book, Fixed(), 0, StreakLimit(5, 10**5), record=True).batch
        assert batch is not None
        recorded[path] = [trajectory for _, _, trajectory in batch.trajectories()]
    one, other = recorded.values()
    assert len(one) == 5
    for compiled, plain in zip(one, other, strict=True):
        assert_same_trajectory(compiled, plain)


def assert_same_trajectory(one: Trajectory, other: Trajectory) -> None:
    for name in ("observation", "action", "reward", "terminated"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    mu: tuple[Any, Any] = (one.probability, other.probability)
    np.testing.assert_allclose(*mu, rtol=0, atol=1e-15)
