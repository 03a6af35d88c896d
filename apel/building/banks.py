"""The learners of all runs of a shard: compiled or in lockstep where that is possible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

from gymnasium import spaces as gymnasium_spaces

from apel.building.learners import let_replay_own, make_learner
from apel.building.registry import LEARNERS, construct, resolve
from apel.building.tables import is_tabular, tabular_learner
from apel.configs import LearnerConfig
from apel.dynamics.batched_environment import BatchedEnvironment
from apel.environments import World, batched_environment, environment_list
from apel.environments.unchanged import replacement_in_class
from apel.experience.representations import View
from apel.experience.sight import Sight
from apel.learners import (
    BatchedLearner,
    CompiledBank,
    LearnerBank,
    LearnerList,
    LockstepBank,
    SingleLearner,
)
from apel.learners.banks.batched_learner import EpisodePlayer
from apel.learners.base import (
    Failure,
    Learner,
    Performance,
    UnbuildableError,
)
from apel.learners.starts import begin_bank
from apel.learners.views import view_of
from apel.numerics.seeding import Role, make_key
from apel.run.user_code import faults_of

_OF_EVERY_CLASS = ("__module__", "__doc__", "__firstlineno__", "__static_attributes__")


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
    raises: bool = False,
) -> LearnerBank:
    """Make learner ``index`` for every run of a shard: compiled where that is possible.

    ``with_probability`` asks compiled banks to record μ(·|s) for the other learners; the others tell what they know.
    ``raises``: what a user's code raises while it plays is raised; otherwise it ends its run.

    Raises
    ------
    UnbuildableError
        If the learners of some of several runs cannot be made.
    """
    bank = _make_bank(
        configs, worlds, run_seeds, index, performance,
        with_probability=with_probability, freezes=freezes, evaluates=evaluates, raises=raises,
    )  # fmt: skip
    begin_bank(bank, configs, [world.spaces for world in worlds])
    return bank


def _make_bank(
    configs: Sequence[LearnerConfig],
    worlds: Sequence[World],
    run_seeds: Sequence[int],
    index: int,
    performance: Performance,
    *,
    with_probability: bool,
    freezes: bool,
    evaluates: bool,
    raises: bool,
) -> LearnerBank:
    keys = [world.key for world in worlds]
    if is_tabular(configs, worlds):
        models = [world.model for world in worlds if world.model is not None]
        learners = [tabular_learner(config, seed, index) for config, seed in zip(configs, run_seeds, strict=True)]
        options = {"with_probability": with_probability, "freezes": freezes, "raises": raises}
        return CompiledBank(models, keys, learners, performance, **options)
    if (batched_type := _batched_type(configs, worlds)) is not None:
        return _bank_of_batched(
            batched_type, configs[0], worlds, run_seeds, index, performance, freezes=freezes, raises=raises
        )
    rows = zip(configs, worlds, run_seeds, strict=True)
    made, failures = list[tuple[Learner, View]](), list[Failure]()
    for run, row in enumerate(rows):
        try:
            with faults_of("learner"):
                made.append(make_learner(*row, index, freezes=freezes, evaluates=evaluates))
        except Exception as error:
            if len(worlds) == 1:
                raise
            failures.append(Failure.unbuilt(run, error))
    if failures:
        raise UnbuildableError(failures, index)
    return bank_of_learners(made, _environment(worlds), worlds, performance, freezes=freezes, raises=raises)


def _environment(worlds: Sequence[World]) -> BatchedEnvironment:
    """In the fastest form; plain learners also play finite environments of different shapes."""
    try:
        return batched_environment(worlds)
    except ValueError:
        return environment_list(worlds)


def bank_of_learners(
    learners: Sequence[tuple[Learner, View]],
    environment: BatchedEnvironment,
    worlds: Sequence[World],
    performance: Performance,
    *,
    freezes: bool = False,
    raises: bool = False,
) -> LockstepBank:
    """The bank of plain learners, one for each run; runs that see alike share a view."""
    actions = [world.environment.action_space for world in worlds]
    sight, seeds = Sight([view for _, view in learners]), [world.seeds for world in worlds]
    batched = LearnerList([learner for learner, _ in learners], actions)
    return LockstepBank(batched, environment, seeds, sight, actions[0], performance, freezes=freezes, raises=raises)


def _batched_type(configs: Sequence[LearnerConfig], worlds: Sequence[World]) -> Callable[..., BatchedLearner] | None:
    """What makes one batched learner of all runs, where there is such a thing and the runs differ in nothing but their
    seeds.
    """
    space = worlds[0].environment.observation_space
    if any(config != configs[0] for config in configs) or any(w.environment.observation_space != space for w in worlds):
        return None
    learner = resolve(configs[0].type, LEARNERS, "learner")
    if isinstance(learner, type) and issubclass(learner, SingleLearner) and not configs[0].members:
        return learner.batched_type if _is_its_batch(learner) else None
    return None


def _is_its_batch(learner: type[SingleLearner]) -> bool:
    """Whether nothing was put in front of the class that names the batched learner, nor in its methods' place."""
    naming = next(kind for kind in learner.__mro__ if "batched_type" in vars(kind))
    heirs = learner.__mro__[: learner.__mro__.index(naming)]
    is_plain = all(name in _OF_EVERY_CLASS for heir in heirs for name in vars(heir))
    return is_plain and replacement_in_class(naming) is None


def _bank_of_batched(
    batched_type: Callable[..., BatchedLearner],
    config: LearnerConfig,
    worlds: Sequence[World],
    run_seeds: Sequence[int],
    index: int,
    performance: Performance,
    *,
    freezes: bool,
    raises: bool,
) -> LockstepBank:
    environment = worlds[0].environment
    constructor = resolve(config.type, LEARNERS, "learner")
    view = view_of(config, constructor, environment.observation_space, environment.action_space, worlds[0].features)
    learner_seeds = [make_key(seed, Role.LEARNER, index) for seed in run_seeds]
    actions = cast("gymnasium_spaces.Discrete", environment.action_space)

    def made(seeds: Sequence[int]) -> BatchedLearner:
        batch = construct(batched_type, config.name, config.options, view.space, int(actions.n), seeds)
        let_replay_own(batch, config)
        return cast("BatchedLearner", batch)

    seeds = [world.seeds for world in worlds]
    sight = Sight([view] * len(worlds))
    environments = batched_environment(worlds)
    learner = made(learner_seeds)
    player = _episode_player(learner, environments, sight, actions)
    return LockstepBank(
        learner, environments, seeds, sight, actions, performance,
        player=player, freezes=freezes, raises=raises, single=lambda: made(learner_seeds[:1]),
    )  # fmt: skip


def _episode_player(
    learner: BatchedLearner, environment: BatchedEnvironment, sight: Sight, actions: gymnasium_spaces.Discrete
) -> EpisodePlayer | None:
    """What plays whole episodes in compiled code, where anything does."""
    if not learner.is_alone:
        return None
    # It loads what only deep learners need.
    from apel.learners.deep.episodes import player_of

    return player_of(learner, environment, sight, actions)


def way_of_learning(config: LearnerConfig, world: World) -> str:
    """How the runs of a learner are played, in words."""
    if is_tabular([config], [world]):
        return "compiled, on the tables"
    return "run by run" if _batched_type([config], [world]) is None else "all runs of a shard at once"
