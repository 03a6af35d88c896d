"""Ensembles with deep learners: the plain loop of Algorithm 5 one run at a time, and all runs of a shard at once."""

from __future__ import annotations

import numpy as np
import pytest

from apel.building.registry import load
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import World, make_world
from apel.experience.representations import Bins, Representation
from apel.learners import LearnerBank, LearnerList, LockstepBank
from apel.learners.base import StreakLimit
from apel.run.criterion import Criterion
from apel.run.selection import freezes_policies
from apel.selectors import Apel, Fixed, Uniform
from tests.apel.freezing import FreezingUniform
from tests.apel.plain_selector import PlainSelector
from tests.apel.rounds import assert_same_rows, ensemble_rows, make_banks, play_rounds

SEEDS = [1892932127, 501869158, 32175636, 389311301]
EPISODES = 9
NEVER = Criterion("length", 3, below=0.5, evaluation="greedy")
MAZE = EnvironmentConfig("apel/Maze-v0", {"size": 4, "distractors": [3], "max_steps": 30}, run_seed="maze_seed")
CART_POLE = EnvironmentConfig("apel/CartPole-v0", {"max_steps": 40})
CORRIDOR = EnvironmentConfig("tests.user_code:Corridor")
TINY = {"network": {"hidden": [8], "activation": "relu"}, "learning_starts": 20}
FEW = Representation(exclude=(1,))
CART_POLE_BINS = Representation(bins=(Bins(-2.4, 2.4, 2), Bins(-3, 3, 2), Bins(-0.21, 0.21, 4), Bins(-3.5, 3.5, 3)))


def learner(letter: str, config: EnvironmentConfig) -> LearnerConfig:
    """A learner by its letter; a capital one is deep."""
    view = FEW if config is not CORRIDOR else Representation()
    bins = CART_POLE_BINS if config is CART_POLE else Representation()
    return {
        "q": LearnerConfig("q_learning", {}, bins),
        "D": LearnerConfig("dqn", {**TINY, "head_hidden": [8], "batch_size": 8, "exploration_fraction": 0.001}),
        "P": LearnerConfig("dqn", {**TINY, "head_hidden": [8], "batch_size": 8, "prioritized": {}}, view),
        "A": LearnerConfig("acer", {**TINY, "learning_starts": 2, "rollout": 7, "replay_size": 30}),
        "M": LearnerConfig("acer", {**TINY, "learning_starts": 2, "preset": "minimalrl"}, view),
        "S": LearnerConfig("sac", {**TINY, "batch_size": 8}, view),
    }[letter]


def worlds_of(config: EnvironmentConfig) -> list[World]:
    factory = load(config.id) if ":" in config.id else None
    return [make_world(config, seed, factory) for seed in SEEDS]


def is_batched(bank: LearnerBank) -> bool:
    """Whether the learners of all runs are computed together."""
    return isinstance(bank, LockstepBank) and not isinstance(bank.learner, LearnerList)


@pytest.mark.parametrize("selector", [Apel(decay=0.05), FreezingUniform(), PlainSelector(Uniform())], ids=repr)
@pytest.mark.parametrize(
    ("letters", "config"),
    [("DA", CART_POLE), ("qPS", CART_POLE), ("qDM", MAZE), ("AP", MAZE), ("DM", CORRIDOR)],
    ids=lambda value: value if isinstance(value, str) else value.id,
)
def test_stacks_give_the_rows_of_algorithm_5(letters: str, config: EnvironmentConfig, selector: object) -> None:
    """Whatever the streaks, the runs of a shard together give, bit for bit, what each run gives by itself."""
    learners = [learner(letter, config) for letter in letters]
    rows, _ = ensemble_rows(learners, worlds_of(config), SEEDS, selector, EPISODES)
    for limit in (StreakLimit(5, 10**4), StreakLimit(1, 1)):
        worlds = worlds_of(config)
        banks = make_banks(learners, worlds, SEEDS, with_probability=True, freezes=freezes_policies(selector))
        assert [is_batched(bank) for bank in banks] == [letter.isupper() for letter in letters]
        played = play_rounds(banks, worlds, SEEDS, selector, EPISODES, limit=limit)
        assert played.failures == []
        assert_same_rows(played.rows, rows)


@pytest.mark.parametrize("letter", ["D", "A", "S"])
def test_greedy_evaluation(letter: str) -> None:
    """What a stack measures without exploring is what a run by itself measures, and changes no row."""
    learners = [learner(letter, CART_POLE)]
    rows, _ = ensemble_rows(learners, worlds_of(CART_POLE), SEEDS, Fixed(), EPISODES, criterion=NEVER)
    worlds = worlds_of(CART_POLE)
    banks = make_banks(learners, worlds, SEEDS, evaluates=True)
    played = play_rounds(banks, worlds, SEEDS, Fixed(), EPISODES, criterion=NEVER)
    assert_same_rows(played.rows, rows)
    unmeasured, _ = ensemble_rows(learners, worlds_of(CART_POLE), SEEDS, Fixed(), EPISODES)
    assert_same_rows(unmeasured, rows)


def test_runs_that_differ_are_not_stacked() -> None:
    """Where the view or an option differs from run to run every run has a learner of its own."""
    worlds = worlds_of(MAZE)
    configs = [LearnerConfig("dqn", TINY, Representation(exclude=(name,))) for name in (0, 1, 2, 2)]
    from apel.building import make_bank

    bank = make_bank(configs, worlds, SEEDS, 0, "return", with_probability=False)
    assert isinstance(bank, LockstepBank)
    assert isinstance(bank.learner, LearnerList)


def test_callable_performance_sees_the_trajectory() -> None:
    """A user's measure of an episode gets what a run by itself gives it."""
    learners = [learner("D", CART_POLE), learner("A", CART_POLE)]
    name = f"{__name__}:last_angle"
    rows, _ = ensemble_rows(learners, worlds_of(CART_POLE), SEEDS, Apel(), EPISODES, performance=name)
    worlds = worlds_of(CART_POLE)
    banks = make_banks(learners, worlds, SEEDS, performance=name, with_probability=True)
    assert_same_rows(play_rounds(banks, worlds, SEEDS, Apel(), EPISODES).rows, rows)


def last_angle(trajectory: object) -> float:
    """The pole's last angle: a measure that needs the observations."""
    return float(trajectory.observation[-1][2])  # type: ignore[attr-defined]


@pytest.mark.parametrize("fault", ["reset", "step", "measure"])
def test_failing_run_fails_alone(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a user's code raises ends one run, named with its episode; the others' rows stay."""
    worlds = worlds_of(CORRIDOR)
    learners = [learner("D", CORRIDOR)]
    (bank,) = make_banks(learners, worlds, SEEDS)
    assert isinstance(bank, LockstepBank)
    rows, _ = ensemble_rows(learners, worlds_of(CORRIDOR), SEEDS, Fixed(), EPISODES)
    broken = worlds[2].environment.unwrapped
    if fault == "measure":
        lengths: list[int] = []

        def performance(trajectory: object) -> float:
            lengths.append(len(trajectory))  # type: ignore[arg-type]
            if len(lengths) == 3:
                raise ArithmeticError("no measure")
            return 0.0

        monkeypatch.setattr(bank, "performance", performance)
    else:
        monkeypatch.setattr(broken, fault, lambda *_, **__: 1 / 0)
    played = play_rounds([bank], worlds, SEEDS, Fixed(), EPISODES)
    (failure,) = played.failures
    assert failure.episode <= 1
    assert ("no measure" if fault == "measure" else "ZeroDivisionError") in failure.error
    for run in {0, 1, 2, 3} - {failure.run}:
        np.testing.assert_array_equal([row[3] for row in played.rows[run]], [row[3] for row in rows[run]])
