"""How an algorithm of stable-baselines3 is found, checked, made and fed, see `apel.learners.stable_baselines`."""

from __future__ import annotations

import copy
import pkgutil
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from apel.learners.base import Transition

ACTION_VALUES: Mapping[str, Callable[[Any, Any], Any]] = {
    "stable_baselines3.dqn.dqn:DQN": lambda policy, observation: policy.q_net(observation),
    "sb3_contrib.qrdqn.qrdqn:QRDQN": lambda policy, observation: policy.quantile_net(observation).mean(dim=1),
}
"""Q(s, ·) of the algorithms that are known to act ε-greedily on it, ``[batch, actions]``."""

OF_SB3S_LOOP = frozenset({"verbose", "tensorboard_log", "stats_window_size", "_init_setup_model"})
"""Options that concern nothing but the loop which is not run here."""


class Feed(gymnasium.Env[Any, Any]):
    """An environment without dynamics: it shows the observation and the transition that it was given last."""

    def __init__(self, observation_space: spaces.Space[Any], action_space: Any) -> None:
        # Copies, because SB3 seeds the action space and draws from it.
        self.observation_space = copy.deepcopy(observation_space)
        self.action_space = spaces.Discrete(int(action_space.n))
        self.observation = self.observation_space.sample()
        self.transition: Transition | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """The observation."""
        return self.observation, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """The transition, whatever the action."""
        assert self.transition is not None  # noqa: S101 - learn() has set it
        _, _, reward, following, terminated, truncated, _ = self.transition
        return following, reward, terminated, truncated, {}


def check_spaces(observation_space: Any, action_space: Any, total_timesteps: int, options: Mapping[str, Any]) -> None:
    """Refuse what no algorithm could do with.

    Raises
    ------
    ValueError
        If a space, the number of steps or an option is not usable.
    """
    if not isinstance(action_space, spaces.Discrete):
        message = f"found the action space {action_space}, expected a Discrete one"
        raise ValueError(message)
    discrete = spaces.Discrete | spaces.MultiDiscrete
    if not isinstance(observation_space, spaces.Box | spaces.MultiBinary | discrete):
        message = f"found the observation space {observation_space}, expected Box, Discrete, MultiDiscrete, MultiBinary"
        raise ValueError(message)
    if isinstance(observation_space, discrete) and np.any(observation_space.start):
        message = f"found the observation space {observation_space}, expected values that are counted from 0"
        raise ValueError(message)
    if total_timesteps < 1:
        message = f"total_timesteps: found {total_timesteps}, expected at least 1"
        raise ValueError(message)
    for name in sorted(OF_SB3S_LOOP.intersection(options)):
        message = f"found the option {name!r}, which has no effect here, expected it to be left out"
        raise ValueError(message)


def off_policy_algorithm(path: str) -> Any:
    """The algorithm at an import path.

    Raises
    ------
    ValueError
        If stable-baselines3 is not installed, or there is no off-policy algorithm of that name.
    """
    try:
        from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    except ImportError as error:
        message = f'found no stable-baselines3 ({error}), expected it to be installed: pip install "apel[sb3]"'
        raise ValueError(message) from error
    found = named(path)
    if not isinstance(found, type) or not issubclass(found, OffPolicyAlgorithm):
        message = (
            f"algorithm: found {path!r}, expected a subclass of stable-baselines3's OffPolicyAlgorithm: others cannot "
            "learn from the trajectories of other learners"
        )
        raise ValueError(message)
    return found


def construct(constructor: Any, path: str, feed: Feed, seed: int, device: str, **options: Any) -> Any:
    """The algorithm on an environment that is fed.

    Raises
    ------
    ValueError
        If it is not for such an environment.
    """
    from stable_baselines3.common.vec_env import DummyVecEnv

    resolved = resolved_option(options)
    if isinstance(resolved.get("train_freq"), list):  # SB3 takes (2, "episode") as a tuple only, which JSON has not
        resolved["train_freq"] = tuple(resolved["train_freq"])
    word = int(np.random.SeedSequence(seed).generate_state(1)[0])
    try:
        return constructor(env=DummyVecEnv([lambda: feed]), seed=word, device=device, **resolved)
    except AssertionError as error:  # which is how SB3 tells its users
        message = f"algorithm: found {path!r}, expected one for this environment: {error}"
        raise ValueError(message) from error


def set_up(algorithm: Any, total_timesteps: int) -> Any:
    """What ``learn()`` does before its loop; returns the callback of that loop, which does nothing."""
    from stable_baselines3.common.logger import Logger

    algorithm.set_logger(Logger(folder=None, output_formats=[]))
    _, callback = algorithm._setup_learn(total_timesteps)
    algorithm.start_time = 0  # the time of day is no part of a learner's state
    return callback


def family_of(constructor: type) -> Any:
    """The ancestor whose action values are known, if there is one."""
    return next((ancestor for ancestor in constructor.__mro__ if path_of(ancestor) in ACTION_VALUES), None)


def path_of(one: type) -> str:
    """The import path of a class."""
    return f"{one.__module__}:{one.__qualname__}"


def named(path: str) -> Any:
    """What stands at an import path.

    Raises
    ------
    ValueError
        If there is nothing.
    """
    try:
        return pkgutil.resolve_name(path)
    except (ImportError, AttributeError, ValueError) as error:
        message = f"found {path!r}, expected an import path 'package.module:Name' ({type(error).__name__}: {error})"
        raise ValueError(message) from error


def resolved_option(option: Any) -> Any:
    """An option in which import paths are replaced by what stands there."""
    match option:
        case str() if ":" in option:
            return named(option)
        case Mapping():
            return {name: resolved_option(one) for name, one in option.items()}
        case list() | tuple():
            return [resolved_option(one) for one in option]
    return option
