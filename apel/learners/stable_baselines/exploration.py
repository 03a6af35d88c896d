"""How stable-baselines3's algorithms are known to act: what they think of actions, what noise they add, and μ."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

ACTION_VALUES: Mapping[str, Callable[[Any, Any], Any]] = {
    "stable_baselines3.dqn.dqn:DQN": lambda policy, observation: policy.q_net(observation),
    "sb3_contrib.qrdqn.qrdqn:QRDQN": lambda policy, observation: policy.quantile_net(observation).mean(dim=1),
}
"""Q(s, ·) of the algorithms that are known to act ε-greedily on it, ``[batch, actions]``."""
_SQUASHED = frozenset({"stable_baselines3.sac.sac:SAC", "sb3_contrib.tqc.tqc:TQC", "sb3_contrib.crossq.crossq:CrossQ"})
"""Those that are known to draw tanh(u) of a Gaussian u."""
_DETERMINISTIC = frozenset({"stable_baselines3.td3.td3:TD3", "stable_baselines3.ddpg.ddpg:DDPG"})
_NOISES = {"normal": "NormalActionNoise", "ornstein_uhlenbeck": "OrnsteinUhlenbeckActionNoise"}

_ROUNDED_FROM = 1.0 - 1e-6


def family_of(constructor: type) -> Any:
    """The ancestor whose way to act is known, if there is one."""
    known = {*ACTION_VALUES, *_SQUASHED, *_DETERMINISTIC}
    return next((ancestor for ancestor in constructor.__mro__ if path_of(ancestor) in known), None)


def is_squashed(family: type) -> bool:
    """Whether a family draws from a squashed Gaussian."""
    return path_of(family) in _SQUASHED


def squashed_density(policy: Any, batch: Any, scaled: Any, widths: Any) -> float | None:
    """The density at an action of what an algorithm of the kin of SAC draws from, in the environment's units.

    With the action ã = tanh u scaled to [−1, 1], u ~ N(μ, σ²), it is Π N(u; μ, σ²) / (1 − ã²) · 2 / width.

    Parameters
    ----------
    policy:
        The algorithm's.
    batch:
        A batch of one observation.
    scaled:
        ``float32[actions]``: ã.
    widths:
        ``float32[actions]``: between the bounds.

    Returns
    -------
    density:
        None where ã is so near a bound that it was rounded.
    """
    import torch

    squashed = np.asarray(scaled, dtype=np.float64).ravel()
    if (np.abs(squashed) > _ROUNDED_FROM).any():
        return None
    with torch.no_grad():
        mean, log_std, _ = policy.actor.get_action_dist_params(policy.obs_to_tensor(batch)[0])
    mean, log_std = (tensor.cpu().numpy().astype(np.float64).ravel() for tensor in (mean, log_std))
    log_gaussian = -0.5 * ((np.arctanh(squashed) - mean) / np.exp(log_std)) ** 2 - log_std - 0.5 * np.log(2 * np.pi)
    return float(np.exp((log_gaussian - np.log(1 - squashed**2) + np.log(2 / widths.ravel())).sum()))


def density_of(algorithm: Any, action_space: Any, batch: Any, scaled: Any) -> float | None:
    """That of an action of SAC's kin, ``scaled`` to [−1, 1]; uniform before ``learning_starts``."""
    widths = action_space.high.astype(np.float64) - action_space.low
    if algorithm.num_timesteps < algorithm.learning_starts:
        return float(np.prod(1.0 / widths))
    return squashed_density(algorithm.policy, batch, scaled, widths)


def noise_of(option: Any, action_space: Any) -> Any:
    """What is added to the actions, scaled to [−1, 1], of an algorithm with continuous ones; None for nothing.

    ``option`` is ``{type: normal, sigma: σ}`` or ``{type: ornstein_uhlenbeck, sigma: σ}``, the latter also with
    ``theta`` and ``dt``.

    Raises
    ------
    ValueError
        If it is something else, or actions are not continuous.
    """
    from stable_baselines3.common import noise

    if option is None:
        return None
    if not isinstance(option, Mapping) or option.get("type") not in _NOISES:
        message = f"action_noise: found {option!r}, expected {{type: {' or '.join(_NOISES)}, sigma: σ}}"
        raise ValueError(message)
    if not isinstance(action_space, spaces.Box):
        message = f"action_noise: found {dict(option)!r} for the actions {action_space}, expected none"
        raise ValueError(message)
    others = {name: value for name, value in option.items() if name != "type"}
    wanted = {"sigma"} | ({"theta", "dt"} if option["type"] == "ornstein_uhlenbeck" else set())
    for name, value in others.items():
        if name not in wanted or type(value) not in (int, float) or not 0 <= value < np.inf:
            message = f"action_noise.{name}: found {value!r}, expected one of {sorted(wanted)}, a number from 0 on"
            raise ValueError(message)
    if "sigma" not in others:
        message = "action_noise.sigma: found none, expected a number from 0 on"
        raise ValueError(message)
    shape = action_space.shape
    sigma = np.full(shape, float(others.pop("sigma")), dtype=np.float32)
    return getattr(noise, _NOISES[option["type"]])(np.zeros(shape, dtype=np.float32), sigma, **others)


def path_of(one: type) -> str:
    """The import path of a class."""
    return f"{one.__module__}:{one.__qualname__}"


def epsilon_greedy(algorithm: Any, batch: Any) -> NDArray[np.float64]:
    """μ(a|s) = ε/n + (1 − ε) [a = greedy action] of the kin of DQN, with ε = 1 before ``learning_starts``."""
    num_actions = int(algorithm.action_space.n)
    if algorithm.num_timesteps < algorithm.learning_starts:
        return np.full(num_actions, 1.0 / num_actions)
    probability = np.full(num_actions, algorithm.exploration_rate / num_actions)
    greedy, _ = algorithm.policy.predict(batch, deterministic=True)
    probability[int(greedy.item())] += 1.0 - algorithm.exploration_rate
    return probability
