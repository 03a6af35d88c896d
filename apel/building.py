"""From configurations to the things themselves: selectors, learners of one run, banks of a shard's runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from apel.configs import LearnerConfig, SelectorConfig
from apel.environments import World
from apel.learners import GenericBank, LearnerBank, QLearning, QLearningOptions, TabularBank
from apel.learners.base import Learner, Performance
from apel.learners.member import Codec, Member
from apel.registry import LEARNERS, METRICS, SELECTORS, resolve
from apel.representations import View
from apel.seeding import Role, make_key
from apel.selection import Selector


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


def make_member(config: LearnerConfig, world: World, run_seed: int, index: int) -> Member:
    """Make learner ``index`` of the run with seed ``run_seed``.

    Raises
    ------
    ValueError
        If it is unknown, refuses its options or the environment, or is not off-policy.
    """
    space = world.environment.observation_space
    view = View(config.representation, space, world.features)
    seed = make_key(run_seed, Role.LEARNER, index)
    constructor = resolve(config.type, LEARNERS, "learner")
    learner = _construct(
        constructor, config.type, dict(config.options), view.space, world.environment.action_space, seed
    )
    if not isinstance(learner, Learner):
        message = f"{config.type}: found {type(learner).__name__}, expected a learner (see apel.Learner)"
        raise ValueError(message)
    if not learner.off_policy:
        message = f"{config.type} is not off-policy: it cannot learn from the trajectories of other learners"
        raise ValueError(message)
    return Member(learner, view, Codec(world.model, space))


def make_bank(
    configs: Sequence[LearnerConfig],
    worlds: Sequence[World],
    run_seeds: Sequence[int],
    index: int,
    performance: Performance,
    *,
    with_probability: bool,
) -> LearnerBank:
    """Make learner ``index`` for every run of a shard: compiled where that is possible.

    ``with_probability`` asks compiled banks to record μ(·|s) for the other learners.
    """
    keys = [world.key for world in worlds]
    if is_tabular(configs, worlds):
        if any(config.representation.bins for config in configs):
            message = "bins: found bins for an environment that is finite already, expected none"
            raise ValueError(message)
        return TabularBank(
            [world.model for world in worlds if world.model is not None],
            keys,
            [_construct(QLearningOptions, config.type, dict(config.options)) for config in configs],
            [config.representation for config in configs],
            [make_key(seed, Role.LEARNER, index) for seed in run_seeds],
            performance,
            with_probability=with_probability,
        )
    rows = zip(configs, worlds, run_seeds, strict=True)
    members = [make_member(config, world, seed, index) for config, world, seed in rows]
    return GenericBank(members, [world.environment for world in worlds], keys, performance)


def is_tabular(configs: Sequence[LearnerConfig], worlds: Sequence[World]) -> bool:
    """Whether a learner's runs can be played by the compiled bank."""
    return all(LEARNERS.get(config.type) is QLearning for config in configs) and all(world.model for world in worlds)


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
    return f"{name}: {place}: found {error['input']!r}, expected {error['msg'].removeprefix('Input should be ')}"
