"""Environments, learners and selectors by every name that they may have, and by the class itself in a script."""

from __future__ import annotations

import functools
from typing import Any

import pytest

import apel
from apel.building import make_bank, make_learner, make_selector, way_of_learning
from apel.configs import EnvironmentConfig, LearnerConfig, Named, SelectorConfig, name_of
from apel.environments import Maze
from apel.learners import CompiledBank, LearnerList, LockstepBank
from apel.learners.deep.dqn import BatchedDqn, Dqn
from tests.apel.registering import Cliff
from tests.apel.user_learner import AverageReward

MAZE = EnvironmentConfig("apel/Maze-v0", {"size": 3, "max_steps": 20})
SMALL: dict[str, Any] = {"network": {"hidden": [4]}, "head_hidden": [4], "learning_starts": 5}


@pytest.mark.parametrize(
    ("id_", "limit"),
    [
        ("tests.apel.registering:tests/Cliff-v3", 11),
        ("tests.apel.registering:Unversioned", 12),
        ("tests/Cliff-v3", 11),
        ("tests.apel.registering:Cliff", 30),
        ("gymnasium.envs.toy_text:CliffWalkingEnv", 30),
        (Cliff, 30),
        (functools.partial(Cliff, is_slippery=True), 30),
        (lambda **_: Cliff(), 30),
    ],
)
def test_environment_by_every_name(id_: Named, limit: int) -> None:
    """Gymnasium's ``module:Id``, import paths and classes, in `make_world` as in a file."""
    world = apel.make_world(EnvironmentConfig(id_, max_episode_steps=None if limit < 30 else 30), 1)
    assert isinstance(world.model, object)
    assert world.model is not None
    assert world.model.max_steps == limit


@pytest.mark.parametrize(
    ("id_", "message"),
    [
        ("tests.apel.registering:Cliff-v9", "tests.apel.registering:Cliff-v9: "),
        ("tests.apel.registering:Clif", "module 'tests.apel.registering' has no 'Clif'"),
        ("tests.apel.registering:", "module 'tests.apel.registering' has no ''"),
        ("no_such_module:Cliff-v3", "no_such_module:Cliff-v3: ModuleNotFoundError: No module named 'no_such_module'"),
        (dict, "builtins:dict: found dict, expected a gymnasium.Env"),
    ],
)
def test_environment_that_is_none(id_: Named, message: str) -> None:
    """One line that names what was asked for."""
    with pytest.raises(ValueError, match=r"found|exist|No module|register") as error:
        apel.make_world(EnvironmentConfig(id_), 1)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_options_and_seeds_reach_a_class() -> None:
    """A maze by its class is the one of its id."""
    named = apel.make_world(EnvironmentConfig("apel/Maze-v0", {"size": 4}, run_seed="maze_seed"), 7)
    by_class = apel.make_world(EnvironmentConfig(Maze, {"size": 4}, run_seed="maze_seed"), 7)
    assert named.model is not None
    assert by_class.model is not None
    assert named.model.next_cell.tolist() == by_class.model.next_cell.tolist()


def test_learner_by_its_class() -> None:
    """A class stands for itself, in messages by its import path, and is played as fast as by its key."""
    world = apel.make_world(MAZE, 1)
    mine = LearnerConfig(AverageReward)
    assert mine.name == "tests.apel.user_learner:AverageReward"
    assert isinstance(make_learner(mine, world, 1, 0)[0], AverageReward)
    with pytest.raises(
        ValueError, match=r"tests.apel.user_learner:AverageReward: .*unexpected keyword argument 'colour'"
    ):
        make_learner(LearnerConfig(AverageReward, {"colour": 1}), world, 1, 0)
    with pytest.raises(ValueError, match="found the learner 3, expected one of"):
        make_learner(LearnerConfig(3), world, 1, 0)  # type: ignore[arg-type]
    assert way_of_learning(LearnerConfig(apel.QLearning), world) == "compiled, on the tables"
    assert way_of_learning(LearnerConfig(Dqn, SMALL), world) == "all runs of a shard at once"
    assert way_of_learning(mine, world) == "run by run"


def test_selector_by_its_class() -> None:
    """As a learner."""
    assert isinstance(make_selector(SelectorConfig(apel.Apel, {"decay": 0.1})), apel.Apel)
    with pytest.raises(ValueError, match=r"apel.selectors.apel:Apel: decay: found 2.0"):
        make_selector(SelectorConfig(apel.Apel, {"decay": 2.0}))


def test_ensemble_of_classes() -> None:
    """What a script wants: its own environment and learner, as they stand there."""
    world = apel.make_world(EnvironmentConfig(Cliff, max_episode_steps=9), 1)
    learners = [LearnerConfig(AverageReward), LearnerConfig("q_learning")]
    records = list(apel.Ensemble(world, learners, apel.Apel(decay=0.1), seed=1, num_episodes=5).run())
    assert [record.length for record in records] == [9] * 5


def test_names() -> None:
    """Of strings, classes, functions, and of what has no name."""
    assert name_of("dqn") == "dqn"
    assert name_of(Maze) == "apel.environments.maze:Maze"
    assert name_of(functools.partial(Cliff)) == "functools:partial"


# Learners that are known, but changed


class Timid(Dqn):
    """Acts otherwise than all runs of a `Dqn` at once would."""

    def act(self, observation: Any) -> Any:
        return 0, super().act(observation)[1]


class Presets(Dqn):
    def __init__(self, observation_space: Any, action_space: Any, seed: int, **options: Any) -> None:
        super().__init__(observation_space, action_space, seed, **{**SMALL, **options})


class Renamed(Dqn):
    """Nothing else."""


class Bold(apel.QLearning):
    def act(self, observation: Any) -> Any:
        action, probability = super().act(observation)
        return int(probability.argmax()) + 0 * action, probability


def bank_of(learner: type, options: dict[str, Any]) -> Any:
    worlds = [apel.make_world(MAZE, seed) for seed in (1, 2)]
    configs = [LearnerConfig(learner, options)] * 2
    return make_bank(configs, worlds, [1, 2], 0, "return", with_probability=False)


@pytest.mark.parametrize(
    ("learner", "options", "kind"),
    [
        (Dqn, SMALL, BatchedDqn),
        (Renamed, SMALL, BatchedDqn),
        (Timid, SMALL, LearnerList),
        (Presets, {}, LearnerList),
        (Bold, {}, LearnerList),
    ],
)
def test_what_a_subclass_changes_is_played(learner: type, options: dict[str, Any], kind: type) -> None:
    """A subclass of a shipped learner is played as it is, not as what it was made from."""
    bank = bank_of(learner, options)
    assert isinstance(bank, LockstepBank)
    assert type(bank.learner) is kind


def test_a_replaced_method_of_a_shipped_learner_is_played(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled code knows nothing of what a user puts in the place of `QLearning.update`."""
    assert isinstance(bank_of(apel.QLearning, {}), CompiledBank)
    monkeypatch.setattr(apel.QLearning, "update", lambda *_: None)
    assert isinstance(bank_of(apel.QLearning, {}), LockstepBank)
