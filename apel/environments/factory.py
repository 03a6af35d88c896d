"""From an environment's description to the environment of one run."""

from __future__ import annotations

import importlib
from dataclasses import dataclass, fields, replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import load_env_creator
from gymnasium.envs.toy_text import FrozenLakeEnv
from gymnasium.wrappers import FlattenObservation, TimeLimit

from apel.configs import EnvironmentConfig, ObservationRule
from apel.dynamics.finite_model import FiniteModel
from apel.environments.closing import close_environment, keep_open
from apel.environments.finite_environment import FiniteEnvironment, HasFiniteModel
from apel.environments.joint import JointEnvironment
from apel.environments.layers import declares_wide_seeds, is_known_maker, takes_wide_seeds
from apel.environments.nested import ConvertedParts
from apel.environments.outcomes import reset
from apel.environments.tables import Tables, tables_of
from apel.experience.action_form import ActionForm
from apel.experience.channels import PLAIN_SPACES, ChannelledEnvironment, signals_of
from apel.experience.joint_space import is_joint
from apel.experience.parts import FlattenedSpace
from apel.experience.spaces import Spaces
from apel.numerics.episode_seeds import EpisodeSeeds, permuted
from apel.numerics.near_names import keyword_meant
from apel.numerics.seeding import Role, make_key
from apel.run.user_code import faults_of, in_a_line

_PLAIN_PARTS = "expected parts that are Box, Discrete, MultiDiscrete or MultiBinary; a wrapper can leave out the others"
_compared_already: dict[tuple[int, str], Any] = {}
"""Of which maker and options it was seen in this process that they make the same tables again; and the maker itself, so
that its number is no other one's.
"""


@dataclass(frozen=True)
class World:
    """The environment of one run.

    Attributes
    ----------
    environment:
        With an array or a number as observation (an entry of its `apel.experience.channels.ChannelSpace` where it has
        channels); finite ones play their tables with this project's streams.
    model:
        The tables, or None where the environment is not finite.
    key:
        Its 64-bit key, from which the seed of each episode follows (`apel.numerics.streams.episode_seed`).
    info:
        The numbers that it reports at its first reset, such as ``optimal_length``.
    features:
        Names of the variables of an observation, where it has names.
    reason:
        Why it is played by its tables, or step by step.
    observations:
        What is done with an observation outside of its space.
    """

    environment: gymnasium.Env[Any, Any]
    model: FiniteModel | None
    key: int
    info: dict[str, float]
    features: tuple[str, ...] | None
    reason: str = ""
    observations: ObservationRule = "check"

    @property
    def spaces(self) -> Spaces:
        """What its observations and actions are elements of."""
        return Spaces(self.environment.observation_space, self.environment.action_space, self.features)

    @property
    def seeds(self) -> EpisodeSeeds:
        """What its episodes are seeded with."""
        return EpisodeSeeds(self.key, takes_wide_seeds(self.environment))


def make_world(config: EnvironmentConfig, run_seed: int, factory: Any = None) -> World:
    """Make the environment of the run with seed ``run_seed``.

    ``factory`` stands for an import path that has been resolved (`apel.building.registry.environment_factory`); without
    it ``config.id`` is a Gymnasium id, or what makes the environment.

    Raises
    ------
    ValueError
        If the environment is unknown, refuses its options, has other tables each time that it is made, or cannot be
        used by an ensemble.
    """
    options = dict(config.options)
    if config.run_seed is not None:
        options[config.run_seed] = _seed_of_run(config, run_seed, factory)
    environment = _make(config, options, factory)
    keep_open(environment)
    try:
        with faults_of("environment"):
            world = _world(config, run_seed, environment)
            if world.model is not None:
                _check_made_again(config, options, factory, world.model)
    except BaseException:
        close_environment(environment)
        raise
    if world.environment.unwrapped is not environment.unwrapped:  # its tables are played
        close_environment(environment)
    keep_open(world.environment, instead_of=environment)
    return world


def _world(config: EnvironmentConfig, run_seed: int, environment: gymnasium.Env[Any, Any]) -> World:
    _check_actions(config, environment)
    _check_map(config, environment)
    signals = signals_of(environment)
    tables = tables_of(environment, config.name) if signals is None else Tables(None, "it has signals")
    if tables.model is not None and not isinstance(environment.unwrapped, HasFiniteModel):
        environment = FiniteEnvironment(tables.model)
    elif signals is not None:
        environment = ChannelledEnvironment(environment, signals)
    elif is_joint(environment.observation_space):
        environment = JointEnvironment(environment)
        tables = replace(tables, features=environment.features)
    elif not isinstance(environment.observation_space, PLAIN_SPACES):
        environment = _flattened(config, environment)
    key = make_key(run_seed, Role.ENVIRONMENT)
    _, info = reset(environment, EpisodeSeeds(key, takes_wide_seeds(environment)).of_episode(0))
    numbers = {name: value.item() if isinstance(value, np.generic) else value for name, value in info.items()}
    of_steps = signals or ()
    numbers = {k: v for k, v in numbers.items() if type(v) in (int, float) and k not in of_steps}
    return World(environment, tables.model, key, numbers, tables.features, tables.reason, config.observations)


def _seed_of_run(config: EnvironmentConfig, run_seed: int, factory: Any) -> int:
    """What an environment that differs from run to run is told: 63 bits where it takes as many, else 31, different ones
    for different runs' seeds.
    """
    key, made = make_key(run_seed, Role.MAZE), _maker(config, factory)
    is_wide = is_known_maker(made) or declares_wide_seeds(made)
    return key >> 1 if is_wide else permuted(run_seed, int(Role.MAZE))


def _maker(config: EnvironmentConfig, factory: Any) -> Any:
    """What makes the environment: a class, a function, or an entry point's text."""
    made = config.id if factory is None else factory
    return _entry_point(made) if isinstance(made, str) else made


def _entry_point(name: str) -> Any:
    """What Gymnasium makes an environment by; of one that there is not, nothing: making it will say so."""
    module, _, name = name.rpartition(":")
    try:
        if module:
            importlib.import_module(module)
        return gymnasium.spec(name).entry_point
    except Exception:  # noqa: BLE001 - a user's module may raise anything
        return None


def _make(config: EnvironmentConfig, options: dict[str, Any], factory: Any) -> gymnasium.Env[Any, Any]:
    made_by: Any = config.id if factory is None else factory
    try:
        with faults_of("environment"):
            if isinstance(made_by, str):
                return gymnasium.make(
                    made_by, max_episode_steps=config.max_episode_steps, disable_env_checker=True, **options
                )
            environment: gymnasium.Env[Any, Any] = made_by(**options)
    except Exception as error:
        # Whatever a constructor raises, it refuses its options.
        told = error if isinstance(error, gymnasium.error.Error | ValueError) else in_a_line(error)
        message = f"{config.name}: {told}{_keyword_meant(error, made_by)}{package_wanted(error, made_by)}"
        raise ValueError(message) from error
    if not isinstance(environment, gymnasium.Env):
        message = f"{config.name}: found {type(environment).__name__}, expected a gymnasium.Env"
        raise ValueError(message)
    if config.max_episode_steps is not None:
        environment = TimeLimit(environment, config.max_episode_steps)
    return environment


def package_wanted(error: Exception, environment: Any) -> str:
    """How to name the environment of another package, where nothing is known of an id by itself; else nothing.

    >>> package_wanted(gymnasium.error.NameNotFound("Environment `MiniGrid` doesn't exist."), "MiniGrid-v0")
    ' An id of another package has its module in front, module:MiniGrid-v0'
    """
    is_unknown = isinstance(error, gymnasium.error.NameNotFound | gymnasium.error.NamespaceNotFound)
    if not is_unknown or not isinstance(environment, str) or ":" in environment:
        return ""
    return f" An id of another package has its module in front, module:{environment}"


def _flattened(config: EnvironmentConfig, environment: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """With vectors for observations."""
    parts = environment.observation_space
    try:
        flattened: gymnasium.Env[Any, Any] = FlattenObservation(ConvertedParts(environment))
    except NotImplementedError as error:
        message = f"{config.name}: found the observation space {parts}, of which no vector can be made; {_PLAIN_PARTS}"
        raise ValueError(message) from error
    vectors = flattened.observation_space
    if not isinstance(vectors, spaces.Box):
        message = f"{config.name}: found the observation space {parts}, with observations of any size; {_PLAIN_PARTS}"
        raise ValueError(message)
    if isinstance(parts, spaces.Dict | spaces.Tuple):
        flattened.observation_space = FlattenedSpace(parts, vectors)
    return flattened


def _check_actions(config: EnvironmentConfig, environment: gymnasium.Env[Any, Any]) -> None:
    try:
        ActionForm(environment.action_space)
    except ValueError as error:
        message = f"{config.name}: {error}"
        raise ValueError(message) from error


def _keyword_meant(error: Exception, made_by: Any) -> str:
    if isinstance(made_by, str):
        made_by = _entry_point(made_by)
        made_by = load_env_creator(made_by) if isinstance(made_by, str) else made_by
    return keyword_meant(error, made_by)


def _check_map(config: EnvironmentConfig, environment: gymnasium.Env[Any, Any]) -> None:
    """An environment is made anew in every process; one that is drawn without a seed would be another one there."""
    is_lake, spec = isinstance(environment.unwrapped, FrozenLakeEnv), environment.unwrapped.spec
    given = config.options if spec is None else {**spec.kwargs, **config.options}
    if is_lake and given.get("map_name", "") is None and given.get("desc") is None:
        message = (
            f"{config.name}: map_name: found None and no desc, for which a map is drawn that nobody can draw again; "
            "expected a desc, such as one that generate_random_map gave once"
        )
        raise ValueError(message)


def _check_made_again(config: EnvironmentConfig, options: dict[str, Any], factory: Any, model: FiniteModel) -> None:
    """Of what a user makes it is not known whether it is drawn without a seed: it is made a second time, once for all
    runs of a process, and its tables are held against those of the first.
    """
    made = _maker(config, factory)
    key = id(made), repr((config.id, config.options, config.run_seed))
    if is_known_maker(made) or key in _compared_already:
        return
    again = _make(config, options, factory)
    keep_open(again)
    try:
        other = tables_of(again, config.name).model
    finally:
        close_environment(again)
    if other is None or not _are_alike(model, other):
        message = (
            f"{config.name}: found other tables when it was made a second time with the same options, expected the "
            "same: it draws without a seed, or carries something over from one that was made before, and would be "
            "another one in every process. What is drawn has to follow from its options, such as a fixed desc or a "
            "seed that run_seed names"
        )
        raise ValueError(message)
    _compared_already[key] = made


def _are_alike(one: FiniteModel, other: FiniteModel) -> bool:
    """Whether two tables are the same, whatever their environments say of themselves beside them."""
    names = [field.name for field in fields(FiniteModel) if field.name != "info"]
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)
