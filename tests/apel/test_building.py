from __future__ import annotations

from typing import Any

import pytest

from apel.building import is_tabular, make_bank, make_learner, make_performance, make_selector
from apel.building.registry import SELECTORS
from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
from apel.environments import World, make_world
from apel.experience.representations import Bins, Representation
from apel.learners import CompiledBank, LockstepBank, QLearning
from apel.numerics.seeding import Role, make_key
from apel.run.selection import Selector
from apel.selectors import Apel, Ssbas
from tests.apel import user_learner

HERE = "tests.apel.user_learner"


@pytest.fixture(scope="module")
def maze() -> World:
    return make_world(EnvironmentConfig("apel/Maze-v0", {"size": 3}), 1)


@pytest.fixture(scope="module")
def cart_pole() -> World:
    return make_world(EnvironmentConfig("CartPole-v1"), 1)


def assert_one_line(error: pytest.ExceptionInfo[ValueError], *parts: str) -> None:
    """The message is one line with all these parts in it."""
    message = str(error.value)
    assert "\n" not in message
    for part in parts:
        assert part in message


@pytest.mark.parametrize("name", sorted(SELECTORS))
def test_every_shipped_selector_is_made_by_name(name: str) -> None:
    """Each name makes a selector with its defaults."""
    assert isinstance(make_selector(SelectorConfig(name)), Selector)


def test_selector_is_made_with_its_options() -> None:
    """Options reach the selector, whether it is named or imported."""
    assert make_selector(SelectorConfig("apel", {"decay": 0.5, "prior": [1, 2]})) == Apel(0.5, (1.0, 2.0))
    assert make_selector(SelectorConfig("apel.selectors:Ssbas", {"exploration": 2})) == Ssbas(2.0)


@pytest.mark.parametrize(
    ("config", "parts"),
    [
        (SelectorConfig("apell"), ["found the selector 'apell'", "'apel', 'apel_margin', "]),
        (SelectorConfig("apel", {"nu": 0.1}), ["apel: found the option 'nu', which it does not have"]),
        (SelectorConfig("apel", {"decay": 1.0}), ["apel: decay: found 1.0", "less than 1"]),
        (SelectorConfig("apel", {"decay": -1}), ["apel: decay: found -1", "greater than or equal to 0"]),
        (SelectorConfig("apel", {"decay": float("nan")}), ["apel: decay: found nan", "finite"]),
        (SelectorConfig("apel", {"prior": [2.0, 0.5]}), ["apel: prior.1: found 0.5"]),
        (SelectorConfig("ssbas", {"exploration": 0}), ["ssbas: exploration: found 0", "greater than 0"]),
        (SelectorConfig("ssbas", {"bounds": [0, 1]}), ["ssbas: bounds: found (0.0, 1.0) with normalise: none"]),
        (SelectorConfig("exp3", {"bounds": [1, 1]}), ["exp3: bounds: found (1.0, 1.0), expected (low, high)"]),
        (SelectorConfig("fixed", {"learner": -1}), ["fixed: learner: found -1"]),
        (SelectorConfig("apel", {"decay": 1.0, "nu": 1}), ["decay: found 1.0", "the option 'nu'"]),
        (SelectorConfig("math:tao"), ["module 'math' has no 'tao'"]),
        (SelectorConfig("no_such_module:Apel"), ["importing 'no_such_module' failed"]),
        (SelectorConfig("math:tau"), ["math:tau: ", "not callable"]),
        (SelectorConfig(f"{HERE}:NoLearner"), ["found NoLearner, expected a selector"]),
        (SelectorConfig("builtins:dict"), ["found dict, expected a selector"]),
    ],
)
def test_wrong_selector_is_one_clear_line(config: SelectorConfig, parts: list[str]) -> None:
    """Unknown names, options and values, and things that are no selector, are refused in one line."""
    with pytest.raises(ValueError, match=r".") as error:
        make_selector(config)
    assert_one_line(error, *parts)


@pytest.mark.parametrize(
    ("config", "parts"),
    [
        (LearnerConfig("dqn2"), ["found the learner 'dqn2'", "'q_learning'"]),
        (LearnerConfig("no_such_module:Learner"), ["importing 'no_such_module' failed: ModuleNotFoundError"]),
        (LearnerConfig(f"{HERE}:Nobody"), [f"module '{HERE}' has no 'Nobody'"]),
        (LearnerConfig(f"{HERE}:NoLearner"), ["found NoLearner without off_policy, ", ", expected a learner"]),
        (LearnerConfig(f"{HERE}:NOT_CALLABLE"), [f"{HERE}:NOT_CALLABLE: ", "not callable"]),
        (LearnerConfig(f"{HERE}:OnPolicy"), [f"{HERE}:OnPolicy is not off-policy"]),
        (LearnerConfig(f"{HERE}:AverageReward", {"explore_every": 0}), ["AverageReward: explore_every: found 0"]),
        (LearnerConfig(f"{HERE}:AverageReward", {"speed": 1}), ["AverageReward: ", "speed"]),
        (LearnerConfig("q_learning", {"speed": 1}), ["q_learning: found the option 'speed', which it does not have"]),
        (LearnerConfig("q_learning", {"learning_rate": 0}), ["q_learning: learning_rate: found 0", "greater than 0"]),
        (LearnerConfig("q_learning", {"discount": 1.5}), ["q_learning: discount: found 1.5"]),
        (LearnerConfig("q_learning", {"exploration": 2.0}), ["q_learning: exploration", "found 2.0"]),
        (LearnerConfig("q_learning", {"exploration": {"start": 1.0}}), ["q_learning: exploration"]),
        (LearnerConfig("q_learning", {}, Representation(exclude=("z",))), ["exclude: found 'z'", "['x', 'y']"]),
        (LearnerConfig("q_learning", {}, Representation(exclude=("x", "y"))), ["exclude: found ['x', 'y']"]),
    ],
)
def test_wrong_learner_is_one_clear_line(maze: World, config: LearnerConfig, parts: list[str]) -> None:
    """A learner that cannot be made is refused in one line, by the plain loop and by a bank alike."""
    with pytest.raises(ValueError, match=r".") as error:
        make_learner(config, maze, 1, 0)
    assert_one_line(error, *parts)
    with pytest.raises(ValueError, match=r".") as error:
        make_bank([config], [maze], [1], 0, "return", with_probability=False)
    assert_one_line(error, *parts)


def test_table_for_a_continuous_environment_is_refused(cart_pole: World) -> None:
    """Q-learning on CartPole without bins says what is missing."""
    with pytest.raises(ValueError, match="a table needs finitely many states; a representation with bins") as error:
        make_learner(LearnerConfig("q_learning"), cart_pole, 1, 0)
    assert_one_line(
        error, "q_learning: found the observation space Box", "or another learner, such as voting, dqn, acer, sac"
    )


def test_bins_that_do_not_fit_are_refused(cart_pole: World) -> None:
    """One entry of bins per feature."""
    config = LearnerConfig("q_learning", {}, Representation(bins=(Bins(-1, 1, 2),)))
    with pytest.raises(ValueError, match="bins: found 1 for"):
        make_learner(config, cart_pole, 1, 0)


def test_member_has_its_own_seed(maze: World) -> None:
    """Learner i of a run is seeded by the run's seed and i, and by nothing else."""
    seeds = set()
    for run_seed, index in ((1, 0), (1, 1), (2, 0)):
        learner = make_learner(LearnerConfig(f"{HERE}:Recorder"), maze, run_seed, index)[0]
        assert isinstance(learner, user_learner.Recorder)
        assert learner.seed == make_key(run_seed, Role.LEARNER, index)
        seeds.add(learner.seed)
    assert len(seeds) == 3


def test_bank_is_compiled_where_possible(maze: World, cart_pole: World) -> None:
    """The shipped Q-learning on tables is compiled; other learners, and other environments, are not."""
    bins = Representation(bins=(Bins(-1, 1, 2),) * 4)
    cases: list[tuple[LearnerConfig, World, bool]] = [
        (LearnerConfig("q_learning"), maze, True),
        (LearnerConfig("apel.learners.tabular.q_learning:QLearning"), maze, False),
        (LearnerConfig(f"{HERE}:AverageReward"), maze, False),
        (LearnerConfig("q_learning", {}, bins), cart_pole, False),
        (LearnerConfig("voting", {"method": "rank"}, members=(LearnerConfig("q_learning"),)), maze, True),
        (LearnerConfig("voting", {"method": "linear"}, members=(LearnerConfig("q_learning"),)), maze, False),
    ]
    for config, world, compiled in cases:
        assert is_tabular([config] * 2, [world] * 2) == compiled
        bank = make_bank([config] * 2, [world] * 2, [1, 2], 0, "return", with_probability=False)
        assert isinstance(bank, CompiledBank if compiled else LockstepBank)


def test_runs_may_differ_in_options_and_views(maze: World) -> None:
    """One bank holds a learner whose options and representation were drawn per run."""
    configs = [
        LearnerConfig("q_learning", {"learning_rate": 0.5}, Representation(exclude=("x",))),
        LearnerConfig("q_learning", {"exploration": {"before": 1.0, "episode": 3, "after": 0.0}}),
    ]
    bank = make_bank(configs, [maze, maze], [1, 2], 0, "return", with_probability=False)
    assert isinstance(bank, CompiledBank)
    assert bank.state()["value"].shape == (2, 9, 4)
    members = [make_learner(config, maze, 1, 0)[0] for config in configs]
    assert all(isinstance(member, QLearning) for member in members)


@pytest.mark.parametrize("name", ["return", "negative_length"])
def test_named_measures_stand_for_themselves(name: str) -> None:
    """Shipped measures are names, which compiled code understands."""
    assert make_performance(name) == name


def test_measure_by_import_path() -> None:
    """Any function of a trajectory will do."""
    assert make_performance(f"{HERE}:actions_taken") is user_learner.actions_taken


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("returns", ["found the performance measure 'returns'", "['negative_length', 'return']"]),
        (f"{HERE}:NOT_CALLABLE", [f"{HERE}:NOT_CALLABLE: found 3.5, expected a function of a trajectory"]),
        (f"{HERE}:nothing", [f"module '{HERE}' has no 'nothing'"]),
    ],
)
def test_wrong_measure_is_one_clear_line(name: str, parts: list[str]) -> None:
    """Unknown measures, and things that cannot be called, are refused in one line."""
    with pytest.raises(ValueError, match=r".") as error:
        make_performance(name)
    assert_one_line(error, *parts)


def test_unknown_option_of_a_user_is_named_like_ours() -> None:
    """What a user's constructor refuses keeps its own words, behind the import path."""
    path = f"{HERE}:AverageReward"
    world: Any = make_world(EnvironmentConfig("FrozenLake-v1"), 1)
    with pytest.raises(ValueError, match=f"^{path}: explore_every: found -3, expected at least 1$"):
        make_learner(LearnerConfig(path, {"explore_every": -3}), world, 1, 0)
