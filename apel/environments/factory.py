"""From an environment's description to the environment of one run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import FlattenObservation, TimeLimit

from apel.channels import PLAIN_SPACES, ChannelledEnvironment, signals_of
from apel.configs import EnvironmentConfig
from apel.environments.finite_environment import FiniteEnvironment, HasFiniteModel, HasTransitionTable, toy_text_model
from apel.finite import FiniteModel
from apel.seeding import Role, make_key
from apel.streams import episode_seed


@dataclass(frozen=True)
class World:
    """The environment of one run.

    Attributes
    ----------
    environment:
        With an array or a number as observation (an entry of its `apel.channels.ChannelSpace` where it has channels);
        finite ones play their tables with this project's streams.
    model:
        The tables, or None where the environment is not finite.
    key:
        Its 64-bit key, from which the seed of each episode follows (`apel.streams.episode_seed`).
    info:
        The numbers that it reports at its first reset, such as ``optimal_length``.
    features:
        Names of the variables of an observation, where it has names.
    """

    environment: gymnasium.Env[Any, Any]
    model: FiniteModel | None
    key: int
    info: dict[str, float]
    features: tuple[str, ...] | None


def make_world(config: EnvironmentConfig, run_seed: int, factory: Any = None) -> World:
    """Make the environment of the run with seed ``run_seed``.

    ``factory`` stands for an import path that has been resolved; without it, ``config.id`` is a Gymnasium id.

    Raises
    ------
    ValueError
        If the environment is unknown, refuses its options, or cannot be used by an ensemble.
    """
    options = dict(config.options)
    if config.run_seed is not None:
        options[config.run_seed] = make_key(run_seed, Role.MAZE) >> 1
    environment = _make(config, options, factory)
    if not isinstance(environment.action_space, spaces.Discrete):
        message = f"{config.id}: found the action space {environment.action_space}, expected a Discrete one"
        raise ValueError(message)
    model = _model(config, environment)
    signals = signals_of(environment)
    if model is not None and not isinstance(environment.unwrapped, HasFiniteModel):
        environment = FiniteEnvironment(model)
    elif signals is not None:
        environment = ChannelledEnvironment(environment, signals)
    elif not isinstance(environment.observation_space, PLAIN_SPACES):
        environment = FlattenObservation(environment)
    key = make_key(run_seed, Role.ENVIRONMENT)
    _, info = environment.reset(seed=episode_seed(np.uint64(key), 0))
    numbers = {name: value.item() if isinstance(value, np.generic) else value for name, value in info.items()}
    of_steps = signals or ()
    numbers = {k: v for k, v in numbers.items() if type(v) in (int, float) and k not in of_steps}
    return World(environment, model, key, numbers, model.features if model else None)


def _make(config: EnvironmentConfig, options: dict[str, Any], factory: Any) -> gymnasium.Env[Any, Any]:
    try:
        if factory is None:
            return gymnasium.make(
                config.id, max_episode_steps=config.max_episode_steps, disable_env_checker=True, **options
            )
        environment: gymnasium.Env[Any, Any] = factory(**options)
    except Exception as error:
        # Whatever a constructor raises, it refuses its options.
        kind = "" if isinstance(error, gymnasium.error.Error | ValueError) else f"{type(error).__name__}: "
        message = f"{config.id}: {kind}{error}"
        raise ValueError(message) from error
    if config.max_episode_steps is not None:
        environment = TimeLimit(environment, config.max_episode_steps)
    return environment


def _model(config: EnvironmentConfig, environment: gymnasium.Env[Any, Any]) -> FiniteModel | None:
    raw = environment.unwrapped
    limit = environment.spec.max_episode_steps if environment.spec else config.max_episode_steps
    if isinstance(raw, HasFiniteModel):
        model = raw.finite_model
        return model if limit is None else replace(model, max_steps=min(limit, model.max_steps))
    if not isinstance(raw, HasTransitionTable):
        return None
    if limit is None:
        message = f"{config.id} sets no limit to an episode: give max_episode_steps"
        raise ValueError(message)
    return toy_text_model(raw, limit)
