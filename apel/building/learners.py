"""Learners of one run from their configurations."""

from __future__ import annotations

from gymnasium import spaces as gymnasium_spaces

from apel.building.registry import LEARNERS, construct, resolve
from apel.configs import LearnerConfig, OwnShare
from apel.environments import World
from apel.experience.representations import Representation, View
from apel.experience.spaces import Spaces
from apel.learners.base import (
    Freezable,
    HasActionValues,
    HasGreedyAction,
    HasReplayMemory,
    Learner,
)
from apel.learners.tabular.voting import Member
from apel.learners.views import view_of
from apel.numerics.seeding import Role, make_key


def make_learner(
    config: LearnerConfig,
    world: World | Spaces,
    run_seed: int,
    index: int,
    *,
    freezes: bool = False,
    evaluates: bool = False,
) -> tuple[Learner, View]:
    """Make learner ``index`` of the run with seed ``run_seed``, and its view of the environment.

    What it is to begin with is not looked at, see `apel.learners.starts`.

    ``freezes``: its policy will be frozen within epochs; ``evaluates``: it will be evaluated without exploring.

    Raises
    ------
    ValueError
        If it is unknown, refuses its options or the environment, is not off-policy, or cannot do what it will have to.
    """
    spaces = world.spaces if isinstance(world, World) else world
    learner, view = _make_learner(config, spaces, run_seed, index)
    if not learner.off_policy and config.learns_from != "own":
        message = f"{config.name} is not off-policy: it cannot learn from the trajectories of other learners, but only "
        message += "with learns_from: own"
        raise ValueError(message)
    if evaluates and not isinstance(learner, HasGreedyAction):
        is_discrete = isinstance(spaces.action, gymnasium_spaces.Discrete)
        if not (is_discrete and isinstance(learner, HasActionValues)):
            missing = "action_values" if is_discrete else "greedy_action"
            message = f"{config.name} has no {missing}: it cannot be evaluated without exploring"
            raise ValueError(message)
    let_replay_own(learner, config)
    if freezes:
        _try_to_freeze(learner, config.name)
    return learner, view


def _make_learner(config: LearnerConfig, spaces: Spaces, run_seed: int, *place: int) -> tuple[Learner, View]:
    """A learner and its view; ``place`` is its index, and its index among the members of the one that holds it."""
    options = dict(config.options)
    constructor = resolve(config.type, LEARNERS, "learner")
    view = view_of(config, constructor, spaces.observation, spaces.action, spaces.features)
    if config.members:
        if config.representation != Representation():
            message = f"{config.name}: found a representation of a learner that has members, expected it on the members"
            raise ValueError(message)
        for member in config.members:
            check_member(member)
        members = enumerate(config.members)
        options["members"] = [Member(*_make_learner(member, spaces, run_seed, *place, i)) for i, member in members]
    seed = make_key(run_seed, Role.LEARNER, *place)
    learner = construct(constructor, config.name, options, view.space, spaces.action, seed)
    if not isinstance(learner, Learner):
        parts = ("off_policy", "act", "learn", "end_episode", "state", "restore")
        lacking = ", ".join(name for name in parts if not hasattr(learner, name))
        message = (
            f"{config.name}: found {type(learner).__name__} without {lacking}, expected a learner (see apel.Learner)"
        )
        raise ValueError(message)
    return learner, view


def check_member(config: LearnerConfig) -> None:
    """Those who vote are asked and taught step by step, by one that keeps nothing for them."""
    seen = config.representation
    if config.learns_from != "all":
        message = f"{config.name}: found learns_from of a learner that votes, expected it on the one that holds it"
        raise ValueError(message)
    if seen.stack > 1 or seen.reward is not None or seen.terminal is not None:
        message = f"{config.name}: found stack, reward or terminal of a learner that votes, expected none of them there"
        raise ValueError(message)


def let_replay_own(learner: object, config: LearnerConfig) -> None:
    """Tell a learner, or all those of a batch, how much of what it replays is to be its own, if its configuration says.

    Raises
    ------
    ValueError
        If it has no replay memory.
    """
    if not isinstance(config.learns_from, OwnShare):
        return
    if not isinstance(learner, HasReplayMemory):
        raise ValueError(no_replay_memory(config))
    try:
        learner.replay_own(config.learns_from.own_share)
    except TypeError as error:
        raise ValueError(no_replay_memory(config)) from error
    except ValueError as error:
        message = f"{config.name}: learns_from: own_share: {error}"
        raise ValueError(message) from error


def no_replay_memory(config: LearnerConfig) -> str:
    """What is said of a learner that has none, and names those that have one."""
    return (
        f"{config.name}: learns_from: found own_share, expected 'all' or 'own', or a learner that draws from a replay "
        "memory: dqn, sac, acer, stable_baselines, or one of your own that has replay_own"
    )


def _try_to_freeze(learner: Learner, name: str) -> None:
    if not isinstance(learner, Freezable):
        message = f"{name} has no freeze: its policy cannot be kept for an epoch, as its selector wants"
        raise ValueError(message)
    try:
        learner.freeze()
    except TypeError as error:
        message = f"{name}: {error}"
        raise ValueError(message) from error
