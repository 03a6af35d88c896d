"""Which learners have a compiled form, and the options of those."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from apel.building.learners import check_member, no_replay_memory
from apel.building.registry import LEARNERS, construct
from apel.configs import LearnerConfig, OwnShare
from apel.environments import World
from apel.environments.unchanged import replacement_in_class
from apel.experience.representations import Representation
from apel.learners import (
    DynaQ,
    DynaQOptions,
    QLearning,
    QLearningOptions,
    TabularLearner,
    TabularMember,
    Voting,
    VotingOptions,
)
from apel.learners.tabular.voting import LINEAR
from apel.numerics.seeding import Role, make_key

_TABLE_OPTIONS: Mapping[Any, type[QLearningOptions]] = {QLearning: QLearningOptions, DynaQ: DynaQOptions}
"""The learners that have a compiled form, with their options."""


def is_tabular(configs: Sequence[LearnerConfig], worlds: Sequence[World]) -> bool:
    """Whether a learner's runs can be played by the compiled bank."""
    return all(_has_tables(config) for config in configs) and all(world.model for world in worlds)


def _has_tables(config: LearnerConfig) -> bool:
    if _shipped(config) is not Voting:
        return _shipped(config) in _TABLE_OPTIONS and not config.members
    are_tabular = all(_shipped(member) in _TABLE_OPTIONS and not member.members for member in config.members)
    return are_tabular and config.options.get("method") != LINEAR


def _shipped(config: LearnerConfig) -> type | None:
    """The learner with a compiled form that is meant; None for any other one, and for one that was changed."""
    learner: Any = LEARNERS.get(config.type) if isinstance(config.type, str) else config.type
    known: type | None = next((one for one in (*_TABLE_OPTIONS, Voting) if one is learner), None)
    return known if known is not None and replacement_in_class(known) is None else None


def tabular_learner(config: LearnerConfig, run_seed: int, index: int) -> TabularLearner:
    """The options of a learner with a compiled form, in the run with seed ``run_seed``.

    Raises
    ------
    ValueError
        If it refuses them.
    """
    if isinstance(config.learns_from, OwnShare):
        raise ValueError(no_replay_memory(config))
    if _shipped(config) is not Voting:
        return TabularLearner((_tabular_member(config, run_seed, index),))
    if not config.members or config.representation != Representation():
        message = f"{config.name}: expected members, each with a representation of its own"
        raise ValueError(message)
    for member in config.members:
        check_member(member)
    return TabularLearner(
        tuple(_tabular_member(member, run_seed, index, i) for i, member in enumerate(config.members)),
        construct(VotingOptions, config.name, config.options),
        make_key(run_seed, Role.LEARNER, index),
    )


def _tabular_member(config: LearnerConfig, run_seed: int, *place: int) -> TabularMember:
    seen = config.representation
    if seen != Representation(exclude=seen.exclude):
        message = f"found {seen} for an environment that is finite already, expected nothing but exclude"
        raise ValueError(message)
    options = construct(_TABLE_OPTIONS[_shipped(config)], config.name, config.options)
    return TabularMember(options, config.representation, make_key(run_seed, Role.LEARNER, *place))
