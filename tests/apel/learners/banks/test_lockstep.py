"""The lockstep bank over a list of learners, held against one plain learner at a time."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from apel.building import make_bank
from apel.building.registry import load
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import World, make_world
from apel.experience.representations import Bins, Representation
from apel.experience.trajectory import Episodes, Trajectory, batch_of
from apel.learners import LearnerBank, LockstepBank
from apel.learners.base import StreakLimit
from apel.run.criterion import Criterion
from apel.run.opening import open_book
from apel.run.state import FINISHED
from apel.selectors import Fixed
from tests.apel.plain_agent import PlainAgent

HERE = "tests.apel.user_learner"
SEEDS = [1892932127, 501869158, 32175636]
EPISODES = 5
PLAIN_Q = "apel.learners.tabular.q_learning:QLearning"
CART_POLE = EnvironmentConfig("CartPole-v1", max_episode_steps=30)
MAZE = EnvironmentConfig("apel/Maze-v0", {"size": 4, "distractors": [3], "max_steps": 30}, run_seed="maze_seed")
LIVES = EnvironmentConfig("tests.channelled:Lives")
BINS = Representation(bins=(Bins(-2.4, 2.4, 2), Bins(-3, 3, 2), Bins(-0.21, 0.21, 4), Bins(-3.5, 3.5, 3)))

CASES: dict[str, tuple[EnvironmentConfig, list[LearnerConfig]]] = {
    "a user's learner": (CART_POLE, [LearnerConfig(f"{HERE}:Opinionated")] * 3),
    "bins": (CART_POLE, [LearnerConfig("q_learning", {"exploration": 0.3}, BINS)] * 3),
    "a table": (MAZE, [LearnerConfig(PLAIN_Q)] * 3),
    "views of different sizes": (
        MAZE,
        [
            LearnerConfig(PLAIN_Q, {}, Representation(exclude=exclude))
            for exclude in (("x",), ("y", "distractor"), ("x",))
        ],
    ),
    "a vote": (
        MAZE,
        [LearnerConfig("voting", members=(LearnerConfig(PLAIN_Q), LearnerConfig(f"{HERE}:Opinionated")))] * 3,
    ),
    "channels": (
        LIVES,
        [
            LearnerConfig(f"{HERE}:Opinionated", {}, Representation(channel="picture", stack=3, reward="bonus")),
            LearnerConfig("q_learning", {}, Representation(channel="number", reward="bonus", terminal="life_lost")),
            LearnerConfig("dqn", {"head_hidden": []}, Representation(channel="picture", stack=2, terminal="life_lost")),
        ],
    ),
    "learners of different kinds": (CART_POLE, [LearnerConfig(f"{HERE}:Opinionated"), LearnerConfig("dqn")] * 2),
}


def worlds_of(config: EnvironmentConfig, num_runs: int) -> list[World]:
    factory = load(config.id) if ":" in config.id else None
    return [make_world(config, seed, factory) for seed in (*SEEDS, 7)[:num_runs]]


def bank_of(name: str) -> tuple[LearnerBank, list[World], list[PlainAgent]]:
    """The bank of a case, on worlds of its own; worlds and learners for the plain agents."""
    config, learners = CASES[name]
    seeds = [*SEEDS, 7][: len(learners)]
    worlds = worlds_of(config, len(learners))
    bank = make_bank(
        learners, worlds_of(config, len(learners)), seeds, 0, "return", with_probability=True, freezes=True
    )
    assert isinstance(bank, LockstepBank)
    rows = zip(learners, worlds, seeds, strict=True)
    return bank, worlds, [PlainAgent(one, world, seed, 0, freezes=True) for one, world, seed in rows]


def assert_same(one: Trajectory, other: Trajectory) -> None:
    for field in ("observation", "action", "reward", "terminated"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
    assert (one.probability is None) == (other.probability is None)
    if one.probability is not None:
        np.testing.assert_array_equal(one.probability, other.probability)


@pytest.mark.parametrize("name", CASES)
def test_lockstep_equals_plain_learners_one_by_one(name: str) -> None:
    """Value for value: what is played, what is measured without exploring, and what is known in the end."""
    bank, worlds, agents = bank_of(name)
    greedy = Criterion("length", 2, below=0.5, evaluation="greedy")
    runs = list(range(len(agents)))
    book = open_book(Fixed(), 1, EPISODES, greedy, runs, [{}] * len(runs))
    while (left := [run for run in runs if book.status[run] != FINISHED]) != []:
        played = bank.play(left, book, Fixed(), 0, StreakLimit(2, 10**4), record=True)
        assert played.failures == ()
        assert played.batch is not None
        measures = dict(
            zip(zip(*(c.tolist() for c in played.episodes[:2]), strict=True), played.episodes.measure, strict=True)
        )
        unknown = 0
        for run, episode, trajectory in played.batch.trajectories():
            environment, seeds = worlds[run].environment, worlds[run].seeds
            expected = agents[run].play(environment, seeds.of_episode(episode), episode)
            # A batch has probabilities where all of its episodes have them.
            if played.batch.probability is None:
                unknown += expected.probability is None
                expected = replace(expected, probability=None)
            assert_same(trajectory, expected)
            length, _ = agents[run].evaluate(environment, seeds.of_evaluation(episode))
            assert measures[run, episode] == length
        assert (unknown > 0) == (played.batch.probability is None)
    assert_same_state(bank.state()["learners"], [agent.learner.state() for agent in agents])


@pytest.mark.parametrize("name", CASES)
def test_learning_from_others_equals_plain_learners_one_by_one(name: str) -> None:
    """The same steps in the same order, whoever played them."""
    bank, _, agents = bank_of(name)
    other, _, _ = bank_of(name)
    runs = list(range(len(agents)))
    book = open_book(Fixed(), 1, EPISODES, None, runs, [{}] * len(runs))
    batch = other.play(runs, book, Fixed(), 0, StreakLimit(EPISODES, 10**5), record=True).batch
    assert batch is not None
    assert bank.learn(batch) == ()
    for run, episode, trajectory in batch.trajectories():
        agents[run].learn(trajectory, episode)
    assert_same_state(bank.state()["learners"], [agent.learner.state() for agent in agents])


@pytest.mark.parametrize(
    ("kind", "config", "freezes"),
    [("dqn", MAZE, False), ("sac", CART_POLE, False), ("acer", MAZE, False), ("acer", CART_POLE, True)],
)
def test_compiled_learners_are_told_several_episodes_at_once(
    kind: str, config: EnvironmentConfig, freezes: bool
) -> None:
    """Those of several runs, with and without known probabilities; one episode at a time they become the same."""
    small: dict[str, Any] = {
        "learning_starts": 2 if kind == "acer" else 20,
        "network": {"hidden": [16], "activation": "relu"},
    }
    small |= {"dueling": False, "head_hidden": []} if kind == "dqn" else {}
    banks = [
        make_bank(
            [LearnerConfig(kind, small)] * 3,
            worlds_of(config, 3),
            SEEDS,
            0,
            "return",
            with_probability=True,
            freezes=freezes,
        )
        for _ in range(3)
    ]
    together, one_by_one, player = banks
    before = pickle.dumps(together.state())
    book = open_book(Fixed(), 1, 80, None, [0, 1, 2], [{}] * 3)
    batch = player.play([0, 1, 2], book, Fixed(), 0, StreakLimit(80, 10**5), record=True).batch
    assert batch is not None
    assert batch.probability is not None
    known = batch.probability.copy()
    known[: int(batch.episodes.length[0])] = np.nan
    batch = replace(batch, probability=known)
    assert len(batch.action) > 3 * 512
    assert together.learn(batch) == ()
    for position, (_, _, trajectory) in enumerate(batch.trajectories()):
        row = Episodes._make(column[position : position + 1] for column in batch.episodes)
        assert one_by_one.learn(batch_of(row, [trajectory])) == ()
    assert_same_state(together.state(), one_by_one.state())
    assert pickle.dumps(together.state()) != before


def assert_same_state(one: Any, other: Any) -> None:
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        one, other = list(one.values()), list(other.values())
    if isinstance(one, list):
        assert len(one) == len(other)
        for mine, yours in zip(one, other, strict=True):
            assert_same_state(mine, yours)
    else:
        np.testing.assert_array_equal(one, other)


class Failing:
    """A learner of a user that fails as it is told to, in its third episode."""

    off_policy = True

    def __init__(self, observation_space: Any, action_space: Any, seed: int, fault: str = "") -> None:
        self._fault, self._episodes = fault, 0

    def act(self, observation: Any) -> Any:
        self._maybe("act")
        return (17 if self._fault == "action" and self._episodes == 2 else 1), None

    def learn(self, transition: Any) -> None:
        self._maybe("learn")

    def end_episode(self) -> None:
        self._maybe("end_episode")
        self._episodes += 1

    def action_values(self, observation: Any) -> Any:
        self._maybe("action_values")
        return np.zeros(2)

    def freeze(self) -> None:
        # It is tried once before the first episode; an epoch begins with the episodes 0, 1 and 3.
        if self._fault == "freeze" and self._episodes == 3:
            self._fail("freeze")

    def state(self) -> Any:
        return {}

    def restore(self, state: Any) -> None:
        pass

    def _maybe(self, fault: str) -> None:
        if self._fault == fault and self._episodes == 2 + (fault == "action_values"):
            self._fail(fault)

    def _fail(self, fault: str) -> None:
        raise LookupError(fault)


FAULTS = {
    "act": (2, "LookupError: act"),
    "action": (2, "ValueError: found the action 17, expected one of Discrete(2)"),
    "learn": (2, "LookupError: learn"),
    "end_episode": (2, "LookupError: end_episode"),
    "action_values": (2, "LookupError: action_values"),
    "freeze": (3, "LookupError: freeze"),
}


def failing_bank(fault: str) -> LearnerBank:
    """Run 1 fails."""
    learners = [LearnerConfig(f"{__name__}:Failing", {"fault": fault if run == 1 else ""}) for run in range(3)]
    worlds = worlds_of(CART_POLE, 3)
    return make_bank(learners, worlds, SEEDS, 0, "return", with_probability=True, freezes=True, evaluates=True)


@pytest.mark.parametrize("fault", FAULTS)
def test_learner_that_fails_while_it_plays_fails_alone(fault: str) -> None:
    """Its run is named with the episode and what was raised; its earlier episodes, and all others' ones, stay."""
    greedy = Criterion("length", 2, below=0.5, evaluation="greedy")
    rows: list[list[Any]] = []
    for bank in (failing_bank(""), failing_bank(fault)):
        book = open_book(Fixed(), 1, EPISODES, greedy, SEEDS, [{}] * 3)
        played = bank.play([0, 1, 2], book, Fixed(), 0, StreakLimit(EPISODES, 10**5), record=True)
        rows.append(sorted(zip(*(column.tolist() for column in played.episodes), strict=True)))
    episode, error = FAULTS[fault]
    assert [failure[:3] for failure in played.failures] == [(1, episode, error)]
    assert rows[1] == [row for row in rows[0] if row[0] != 1 or row[1] < episode]


@pytest.mark.parametrize("fault", ["learn", "end_episode", "freeze"])
def test_learner_that_fails_at_others_episodes_fails_alone(fault: str) -> None:
    """It learns no further; the others learn from all."""
    player = failing_bank("")
    book = open_book(Fixed(), 1, EPISODES, None, SEEDS, [{}] * 3)
    batch = player.play([0, 1, 2], book, Fixed(), 0, StreakLimit(EPISODES, 10**5), record=True).batch
    assert batch is not None
    bank = failing_bank(fault)
    episode, error = FAULTS[fault]
    assert [failure[:3] for failure in bank.learn(batch)] == [(1, episode, error)]
    learners = bank.learner.learners  # type: ignore[attr-defined]
    assert [one._episodes for one in learners] == [EPISODES, episode, EPISODES]


def test_learners_may_keep_what_they_are_told() -> None:
    """No array that a learner was given is written to afterwards."""
    config = LearnerConfig(f"{__name__}:Keeping", {}, Representation(channel="picture", stack=2, terminal="life_lost"))
    worlds = worlds_of(LIVES, 3)
    for learns in (False, True):
        bank, player = (make_bank([config] * 3, worlds, SEEDS, 0, "return", with_probability=True) for _ in range(2))
        book = open_book(Fixed(), 1, EPISODES, None, SEEDS, [{}] * 3)
        batch = (player if learns else bank).play([0, 1, 2], book, Fixed(), 0, StreakLimit(5, 10**5), record=True).batch
        assert batch is not None
        if learns:
            bank.learn(batch)
        for learner in bank.learner.learners:  # type: ignore[attr-defined]
            assert len(learner.kept) >= 2 * 12 * EPISODES
            for array, copy in learner.kept:
                np.testing.assert_array_equal(array, copy)


class Keeping(Failing):
    """Keeps every observation, and a copy of it."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.kept: list[tuple[Any, Any]] = []

    def act(self, observation: Any) -> Any:
        self.kept.append((observation, np.array(observation)))
        return 0, None

    def learn(self, transition: Any) -> None:
        for seen in (transition.observation, transition.next_observation):
            self.kept.append((seen, np.array(seen)))
