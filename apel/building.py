"""From configurations to the things themselves: selectors, learners of one run, banks of a shard's runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from gymnasium import spaces
from pydantic import ValidationError

from apel.configs import LearnerConfig, SelectorConfig
from apel.environments import World, batched_environment
from apel.learners import (
    DynaQ,
    DynaQOptions,
    GenericBank,
    LearnerBank,
    QLearning,
    QLearningOptions,
    SingleLearner,
    StackedBank,
    StackedLearner,
    TabularBank,
    TabularLearner,
    TabularMember,
    Voting,
    VotingOptions,
)
from apel.learners.base import Freezable, HasActionValues, Learner, Performance
from apel.learners.member import Codec, Member
from apel.learners.voting import Voter
from apel.registry import LEARNERS, METRICS, SELECTORS, resolve
from apel.representations import Representation, View, WholeView
from apel.seeding import Role, make_key
from apel.selection import Selector

_TABLE_OPTIONS: Mapping[Any, type[QLearningOptions]] = {QLearning: QLearningOptions, DynaQ: DynaQOptions}
"""The learners that have a compiled form, with their options."""


def make_selector(config: SelectorConfig) -> Selector:
    """Make a selector.

    Raises
    ------
    ValueError
        If it is unknown, refuses its options, or is none.
    """
    selector = _construct(resolve(config.type, SELECTORS, "selector"), config.type, dict(config.options))
    if not isinstance(selector, Selector):
        message = f"{config.type}: found {type(selector).__name__}, expected a selector (see apel.selection.Selector)"
        raise ValueError(message)
    return selector


def make_performance(name: str) -> Performance:
    """The performance measure of that name or import path: a function of a trajectory."""
    measure: Performance = resolve(name, METRICS, "performance measure")
    if not callable(measure) and measure not in METRICS:
        message = f"{name}: found {measure!r}, expected a function of a trajectory"
        raise ValueError(message)
    return measure


def make_member(
    config: LearnerConfig, world: World, run_seed: int, index: int, *, freezes: bool = False, evaluates: bool = False
) -> Member:
    """Make learner ``index`` of the run with seed ``run_seed``.

    ``freezes``: its policy will be frozen within epochs; ``evaluates``: it will be evaluated without exploring.

    Raises
    ------
    ValueError
        If it is unknown, refuses its options or the environment, is not off-policy, or cannot do what it will have to.
    """
    space, actions = world.environment.observation_space, world.environment.action_space
    learner, view = _make_learner(config, world, run_seed, index)
    if not learner.off_policy:
        message = f"{config.type} is not off-policy: it cannot learn from the trajectories of other learners"
        raise ValueError(message)
    if evaluates and not isinstance(learner, HasActionValues):
        message = f"{config.type} has no action_values: it cannot be evaluated without exploring"
        raise ValueError(message)
    if freezes:
        _try_to_freeze(learner, config.type)
    return Member(learner, view, Codec(world.model, space), actions, freezes=freezes)


def _make_learner(config: LearnerConfig, world: World, run_seed: int, *place: int) -> Voter:
    """A learner and its view; ``place`` is its index, and its index among the members of the one that holds it."""
    environment = world.environment
    options = dict(config.options)
    if not config.members:
        view = View(config.representation, environment.observation_space, world.features)
    else:
        view = WholeView(environment.observation_space)
        if config.representation != Representation():
            message = f"{config.type}: found a representation of a learner that has members, expected it on the members"
            raise ValueError(message)
        for member in config.members:
            _check_voter(member)
        members = enumerate(config.members)
        options["members"] = [_make_learner(member, world, run_seed, *place, i) for i, member in members]
    seed = make_key(run_seed, Role.LEARNER, *place)
    constructor = resolve(config.type, LEARNERS, "learner")
    learner = _construct(constructor, config.type, options, view.space, environment.action_space, seed)
    if not isinstance(learner, Learner):
        message = f"{config.type}: found {type(learner).__name__}, expected a learner (see apel.Learner)"
        raise ValueError(message)
    return Voter(learner, view)


def _check_voter(config: LearnerConfig) -> None:
    """Those who vote are asked and taught step by step, by one that keeps nothing for them."""
    seen = config.representation
    if seen.stack > 1 or seen.reward is not None or seen.terminal is not None:
        message = f"{config.type}: found stack, reward or terminal of a learner that votes, expected none of them there"
        raise ValueError(message)


def _try_to_freeze(learner: Learner, name: str) -> None:
    if not isinstance(learner, Freezable):
        message = f"{name} has no freeze: its policy cannot be kept for an epoch, as its selector wants"
        raise ValueError(message)
    try:
        learner.freeze()
    except TypeError as error:
        message = f"{name}: {error}"
        raise ValueError(message) from error


def make_bank(
    configs: Sequence[LearnerConfig],
    worlds: Sequence[World],
    run_seeds: Sequence[int],
    index: int,
    performance: Performance,
    *,
    with_probability: bool,
    freezes: bool = False,
    evaluates: bool = False,
) -> LearnerBank:
    """Make learner ``index`` for every run of a shard: compiled where that is possible.

    ``with_probability`` asks compiled banks to record μ(·|s) for the other learners; for the others see `make_member`.
    """
    keys = [world.key for world in worlds]
    if is_tabular(configs, worlds):
        models = [world.model for world in worlds if world.model is not None]
        learners = [_tabular_learner(config, seed, index) for config, seed in zip(configs, run_seeds, strict=True)]
        return TabularBank(models, keys, learners, performance, with_probability=with_probability, freezes=freezes)
    if (stacked_type := _stacked_type(configs, worlds)) is not None:
        return _stacked_bank(stacked_type, configs[0], worlds, run_seeds, index, performance, freezes=freezes)
    rows = zip(configs, worlds, run_seeds, strict=True)
    members = [
        make_member(config, world, seed, index, freezes=freezes, evaluates=evaluates) for config, world, seed in rows
    ]
    return GenericBank(members, [world.environment for world in worlds], keys, performance)


def _stacked_type(configs: Sequence[LearnerConfig], worlds: Sequence[World]) -> Callable[..., StackedLearner] | None:
    """What makes one stacked learner of all runs, where there is such a thing and the runs differ in nothing but their
    seeds.
    """
    space = worlds[0].environment.observation_space
    if any(config != configs[0] for config in configs) or any(w.environment.observation_space != space for w in worlds):
        return None
    learner = resolve(configs[0].type, LEARNERS, "learner")
    if isinstance(learner, type) and issubclass(learner, SingleLearner) and not configs[0].members:
        return learner.stacked_type
    return None


def _stacked_bank(
    stacked_type: Callable[..., StackedLearner],
    config: LearnerConfig,
    worlds: Sequence[World],
    run_seeds: Sequence[int],
    index: int,
    performance: Performance,
    *,
    freezes: bool,
) -> StackedBank:
    environment = worlds[0].environment
    view = View(config.representation, environment.observation_space, worlds[0].features)
    seeds = [make_key(seed, Role.LEARNER, index) for seed in run_seeds]
    actions = cast("spaces.Discrete", environment.action_space)
    learner = _construct(stacked_type, config.type, config.options, view.space, int(actions.n), seeds)
    keys = [world.key for world in worlds]
    return StackedBank(learner, batched_environment(worlds), keys, view, actions, performance, freezes=freezes)


def is_tabular(configs: Sequence[LearnerConfig], worlds: Sequence[World]) -> bool:
    """Whether a learner's runs can be played by the compiled bank."""
    return all(_has_tables(config) for config in configs) and all(world.model for world in worlds)


def _has_tables(config: LearnerConfig) -> bool:
    learner = LEARNERS.get(config.type)
    if learner is Voting:
        return all(LEARNERS.get(member.type) in _TABLE_OPTIONS and not member.members for member in config.members)
    return learner in _TABLE_OPTIONS and not config.members


def _tabular_learner(config: LearnerConfig, run_seed: int, index: int) -> TabularLearner:
    if LEARNERS[config.type] is not Voting:
        return TabularLearner((_tabular_member(config, run_seed, index),))
    if not config.members or config.representation != Representation():
        message = f"{config.type}: expected members, each with a representation of its own"
        raise ValueError(message)
    return TabularLearner(
        tuple(_tabular_member(member, run_seed, index, i) for i, member in enumerate(config.members)),
        _construct(VotingOptions, config.type, config.options),
        make_key(run_seed, Role.LEARNER, index),
    )


def _tabular_member(config: LearnerConfig, run_seed: int, *place: int) -> TabularMember:
    seen = config.representation
    if seen != Representation(exclude=seen.exclude):
        message = f"found {seen} for an environment that is finite already, expected nothing but exclude"
        raise ValueError(message)
    options = _construct(_TABLE_OPTIONS[LEARNERS[config.type]], config.type, config.options)
    return TabularMember(options, config.representation, make_key(run_seed, Role.LEARNER, *place))


def _construct(constructor: Any, name: str, options: Mapping[str, Any], *arguments: Any) -> Any:
    """Call a constructor of ours or of the user's; whatever it refuses becomes one clear `ValueError`."""
    try:
        return constructor(*arguments, **options)
    except ValidationError as error:
        raise ValueError("; ".join(_describe(name, one) for one in error.errors())) from error
    except (TypeError, ValueError) as error:
        message = f"{name}: {error}"
        raise ValueError(message) from error


def _describe(name: str, error: Any) -> str:
    place = ".".join(str(part) for part in error["loc"])
    if error["type"] == "unexpected_keyword_argument":
        return f"{name}: found the option {place!r}, which it does not have"
    if error["type"] == "value_error":  # our own words
        return f"{name}: {place}{': ' if place else ''}{error['msg'].removeprefix('Value error, ')}"
    return f"{name}: {place}: found {error['input']!r}, expected {error['msg'].removeprefix('Input should be ')}"
