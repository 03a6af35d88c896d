"""How an algorithm of stable-baselines3 is found, checked, made and fed, see `.adapter`."""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from apel.learners.base import Transition
from apel.learners.stable_baselines.sb3_spaces import sb3_action_space, sb3_observation, sb3_observation_space

OF_SB3S_LOOP = frozenset({"verbose", "tensorboard_log", "stats_window_size", "_init_setup_model"})
"""Options that concern nothing but the loop which is not run here."""


class Feed(gymnasium.Env[Any, Any]):
    """An environment without dynamics: it shows the observation and the transition that it was given last."""

    def __init__(self, observation_space: spaces.Space[Any], action_space: Any) -> None:
        self._shown = observation_space
        self.observation_space = sb3_observation_space(observation_space)
        self.action_space = sb3_action_space(action_space)
        self.observation = self.observation_space.sample()
        self.transition: Transition | None = None

    def show(self, observation: Any) -> None:
        """What `reset` gives next."""
        self.observation = sb3_observation(self._shown, observation)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """The observation."""
        return self.observation, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """The transition, whatever the action."""
        assert self.transition is not None  # noqa: S101 - learn() has set it
        _, _, reward, next_observation, terminated, truncated, _ = self.transition
        return sb3_observation(self._shown, next_observation), reward, terminated, truncated, {}


def check_options(total_timesteps: int, options: Mapping[str, Any]) -> None:
    """Refuse what no algorithm could do with.

    Raises
    ------
    ValueError
        If the number of steps or an option is not usable.
    """
    if total_timesteps < 1:
        message = f"total_timesteps: found {total_timesteps}, expected at least 1"
        raise ValueError(message)
    for name in sorted(OF_SB3S_LOOP.intersection(options)):
        message = f"found the option {name!r}, which has no effect here, expected it to be left out"
        raise ValueError(message)


def check_algorithm(algorithm: Any) -> None:
    """Refuse what draws, or remembers, in a way that cannot be gone on with here.

    Raises
    ------
    ValueError
        If the algorithm has such an option.
    """
    from stable_baselines3 import HerReplayBuffer

    if algorithm.use_sde:
        message = (
            "found use_sde: True, expected False: its noise is drawn once per rollout, of which there are none here"
        )
        raise ValueError(message)
    if isinstance(algorithm.replay_buffer, HerReplayBuffer):
        message = "replay_buffer_class: found HerReplayBuffer, which asks the environment, expected one that does not"
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
        raise _not_installed(error) from error
    others = (
        ": others cannot learn from the trajectories of other learners; those that are on-policy are of the type "
        "stable_baselines_on_policy, with learns_from: own"
    )
    return _named_subclass(path, OffPolicyAlgorithm, others)


def on_policy_algorithm(path: str) -> Any:
    """The algorithm at an import path.

    Raises
    ------
    ValueError
        If stable-baselines3 is not installed, or there is no on-policy algorithm of that name.
    """
    try:
        from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
    except ImportError as error:
        raise _not_installed(error) from error
    return _named_subclass(path, OnPolicyAlgorithm)


def _named_subclass(path: str, base: Any, others: str = "") -> Any:
    found = named(path)
    if not isinstance(found, type) or not issubclass(found, base):
        message = f"algorithm: found {path!r}, expected a subclass of stable-baselines3's {base.__name__}{others}"
        raise ValueError(message)
    return found


def _not_installed(error: ImportError) -> ValueError:
    message = f'found no stable-baselines3 ({error}), expected it to be installed: pip install "apel[sb3]"'
    return ValueError(message)


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


def constructor_options(kind: type) -> set[str]:
    """The names of all options of an algorithm's constructor, those that it passes on included."""
    inits = [vars(ancestor)["__init__"] for ancestor in kind.__mro__ if "__init__" in vars(ancestor)]
    return {name for init in inits if init is not object.__init__ for name in inspect.signature(init).parameters}


def set_up(algorithm: Any, total_timesteps: int) -> Any:
    """What ``learn()`` does before its loop; returns the callback of that loop, which does nothing."""
    from stable_baselines3.common.logger import Logger

    algorithm.set_logger(Logger(folder=None, output_formats=[]))
    _, callback = algorithm._setup_learn(total_timesteps)
    algorithm.start_time = 0  # the time of day is no part of a learner's state
    return callback


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


def train_when_due(algorithm: Any, steps: int, episodes: int) -> bool:
    """What ``OffPolicyAlgorithm.learn()`` does between two rollouts; whether the last one was as long as ``train_freq``
    wants it.
    """
    from stable_baselines3.common.utils import should_collect_more_steps

    if should_collect_more_steps(algorithm.train_freq, steps, episodes):
        return False
    gradient_steps = algorithm.gradient_steps if algorithm.gradient_steps >= 0 else steps
    if algorithm.num_timesteps > algorithm.learning_starts and gradient_steps > 0:
        algorithm.train(gradient_steps=gradient_steps, batch_size=algorithm.batch_size)
    return True
