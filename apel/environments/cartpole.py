"""The cart pole of the dissertation (§4.1.2): Gymnasium's, with its two ambiguities as options.

A pole stands on a cart; pushing the cart to the left or to the right is to keep it upright. The dynamics are those of
Barto, Sutton & Anderson 1983, as `gymnasium.envs.classic_control.cartpole` computes them, one run at a time
(`CartPole`) or many at once (`BatchedCartPole`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from functools import cache
from typing import Any, Literal, NamedTuple, cast, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.classic_control.cartpole import CartPoleEnv
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs, Stepped
from apel.dynamics.worlds import CartPoleWorld, trigonometry
from apel.environments.comparison import plays_beside_its_batch
from apel.environments.drawing import draw_cart_pole
from apel.environments.misuse import NO_EPISODE, check_step, check_under_way
from apel.environments.unchanged import replacement_in

TimeLimit = Literal["terminal", "truncation"]
_compared_already: dict[tuple[Any, ...], str | None] = {}
"""What was found where cart poles of some parameters were held against their arrays in this process before."""


class CartPole(CartPoleEnv):
    """Gymnasium's cart pole, which ends its episodes itself.

    Observation: ``float32[4]``, the cart's position in m and velocity in m/s, the pole's angle in rad and angular
    velocity in rad/s; drawn uniformly from ±0.05 at reset. Actions: 0 pushes left, 1 pushes right. Reward: +1 per
    step, the last one included. Terminated where the pole leans by more than ``angle_limit`` or the cart is more than
    2.4 m away. Solved: a mean return of at least 195 over 100 episodes of 200 steps.

    The default limit is 12°, as in the article, in Gymnasium, and in the code of OpenAI Gym's CartPole-v0. The
    dissertation's text says 15°, like the web page of that environment, which its code contradicted
    (https://github.com/openai/gym/issues/702).

    Parameters
    ----------
    angle_limit:
        In degrees, above 0 and at most 90. The bounds of the observation space are twice as far, so that the
        observation that ends an episode lies inside.
    max_steps:
        Steps after which an episode ends.
    time_limit:
        How an episode is reported whose step number ``max_steps`` did not fail: ``"terminal"``, like any other end,
        as OpenAI Gym of that time did (whoever learns takes what follows to be worth nothing); or ``"truncation"``.
    render_mode:
        See Gymnasium.

    Raises
    ------
    ValueError
        If an argument makes no sense.

    Source: Barto, Sutton & Anderson 1983, *Neuronlike adaptive elements that can solve difficult learning control
    problems*, IEEE Transactions on Systems, Man, and Cybernetics 13(5).
    """

    def __init__(
        self,
        angle_limit: float = 12,
        max_steps: int = 200,
        time_limit: TimeLimit = "terminal",
        render_mode: str | None = None,
    ) -> None:
        _check(angle_limit, max_steps, time_limit)
        super().__init__(render_mode=render_mode)
        self.max_steps = max_steps
        self.time_limit = time_limit
        # In this order, as there: another one moves the last bit.
        self.theta_threshold_radians = angle_limit * 2 * math.pi / 360
        high = np.array(
            [self.x_threshold * 2, np.inf, self.theta_threshold_radians * 2, np.inf],
            dtype=np.float32,
        )
        self.observation_space = spaces.Box(-high, high, dtype=np.float32)
        self._steps = NO_EPISODE

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode; ``options`` as in Gymnasium."""
        observation, info = super().reset(seed=seed, options=options)
        self._steps = 0
        return observation, info

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Play one action.

        Raises
        ------
        RuntimeError
            If no episode is under way.
        ValueError
            If there is no such action.
        """
        check_step(action, self.action_space, self._steps)
        observation, reward, failed, _, info = super().step(action)  # type: ignore[no-untyped-call]
        self._steps += 1
        at_limit = not failed and self._steps >= self.max_steps
        if failed or at_limit:
            self._steps = NO_EPISODE
        is_terminal = self.time_limit == "terminal"
        return observation, reward, failed or (at_limit and is_terminal), at_limit and not is_terminal, info

    def render(self) -> Any:
        """See Gymnasium; an array is drawn here, for which nobody needs pygame."""
        if self.render_mode != "rgb_array" or self.state is None:
            return super().render()  # type: ignore[no-untyped-call]
        position, _, angle, _ = map(float, self.state)
        # Gymnasium's ``length`` is half of the pole's.
        return draw_cart_pole(position, angle, 2 * self.length, self.x_threshold, self.theta_threshold_radians)


def _check(angle_limit: float, max_steps: int, time_limit: str) -> None:
    if not isinstance(angle_limit, int | float) or not 0 < angle_limit <= 90:
        message = f"angle_limit: found {angle_limit!r}, expected a number of degrees above 0 and at most 90"
        raise ValueError(message)
    if not isinstance(max_steps, int) or max_steps < 1:
        message = f"max_steps: found {max_steps!r}, expected a whole number of at least 1"
        raise ValueError(message)
    if time_limit not in get_args(TimeLimit):
        message = f"time_limit: found {time_limit!r}, expected one of {list(get_args(TimeLimit))}"
        raise ValueError(message)


class CartPoleParameters(NamedTuple):
    """All that an episode depends on, besides its seed and its actions; names as in Gymnasium, SI units."""

    gravity: float
    masspole: float
    total_mass: float
    length: float
    polemass_length: float
    force_mag: float
    tau: float
    kinematics_integrator: str
    x_threshold: float
    theta_threshold_radians: float
    max_steps: int
    time_limit: TimeLimit

    @classmethod
    def of(cls, environment: CartPole) -> CartPoleParameters:
        """Those of ``environment``."""
        return cls._make(getattr(environment, name) for name in cls._fields)


class BatchedCartPole:
    """R runs of `CartPole` as arrays, equal to it bit for bit (see `apel.dynamics.batched_environment`).

    Parameters
    ----------
    parameters:
        Those of every run, with the integrator ``"euler"``.
    num_runs:
        R.
    """

    def __init__(self, parameters: CartPoleParameters, num_runs: int) -> None:
        self._parameters = parameters
        # One row per variable, so that each is contiguous.
        self._state = np.zeros((4, num_runs))
        self._steps = np.full(num_runs, NO_EPISODE, dtype=np.int64)

    def reset(self, runs: Runs, seeds: Sequence[int]) -> Stepped:
        """Start an episode of each run with its seed; entries are observations, ``float32[A, 4]``."""
        state = np.array([_start(seed) for seed in seeds]).T
        self._state[:, runs] = state
        self._steps[runs] = 0
        terminated, truncated = np.zeros((2, len(runs)), dtype=np.bool_)
        return Stepped(_observation(state), np.zeros(len(runs)), terminated, truncated)

    def step(self, runs: Runs, actions: NDArray[np.int64]) -> Stepped:
        """Push each cart.

        Raises
        ------
        RuntimeError
            If a run has no episode under way.
        ValueError
            If there is no such action.
        """
        steps = self._steps[runs]
        check_under_way(steps)
        _check_actions(actions)
        state = _integrate(self._parameters, self._state.take(runs, axis=1), actions)
        failed = _has_failed(self._parameters, state)
        steps += 1
        over = failed | (steps >= self._parameters.max_steps)
        steps[over] = NO_EPISODE
        self._state[:, runs] = state
        self._steps[runs] = steps
        terminated = over if self._parameters.time_limit == "terminal" else failed
        return Stepped(_observation(state), np.ones(len(runs)), terminated, over & ~terminated)

    def decode(self, entries: NDArray[np.float32]) -> NDArray[np.float32]:
        """Entries are raw observations."""
        return entries

    def world(self, run: int) -> CartPoleWorld | None:
        """See `apel.dynamics.worlds.HasWorlds`; all runs are alike."""
        if not _has_same_trigonometry():
            return None
        p = self._parameters
        dynamics = {name: getattr(p, name) for name in CartPoleWorld._fields if name in p._fields}
        limit = p.time_limit == "terminal"
        return CartPoleWorld(**dynamics, limit_terminates=limit, state=np.zeros(4))

    def start(self, seed: int) -> NDArray[np.float64]:
        """See `apel.dynamics.worlds.HasWorlds`: the state at reset."""
        return _start(seed)


def _start(seed: int) -> NDArray[np.float64]:
    return np_random(int(seed))[0].uniform(-0.05, 0.05, 4)


@cache
def _has_same_trigonometry() -> bool:
    """Whether compiled code has NumPy's sines and cosines: both are the machine's, but need not be the same ones."""
    angles = np.random.default_rng(1).uniform(-math.pi, math.pi, 4096)
    return bool(np.array_equal(trigonometry(angles), (np.sin(angles), np.cos(angles))))


def _check_actions(actions: NDArray[np.int64]) -> None:
    if ((actions != 0) & (actions != 1)).any():
        message = f"found the actions {actions.tolist()}, expected 0 or 1 each"
        raise ValueError(message)


def _integrate(p: CartPoleParameters, state: NDArray[np.float64], actions: NDArray[np.int64]) -> NDArray[np.float64]:
    """One Euler step of ``float64[4, A]``.

    The same operations in the same order as in `CartPoleEnv.step`, for any other order rounds differently. A cosine
    of an array has the bits of the cosines of its elements: NumPy sends scalars through the same loop.
    """
    x, x_dot, theta, theta_dot = state
    force = np.where(actions == 1, p.force_mag, -p.force_mag)
    cosine, sine = np.cos(theta), np.sin(theta)
    temp = (force + p.polemass_length * np.square(theta_dot) * sine) / p.total_mass
    theta_acceleration = (p.gravity * sine - cosine * temp) / (
        p.length * (4.0 / 3.0 - p.masspole * np.square(cosine) / p.total_mass)
    )
    x_acceleration = temp - p.polemass_length * theta_acceleration * cosine / p.total_mass
    return np.array(
        (
            x + p.tau * x_dot,
            x_dot + p.tau * x_acceleration,
            theta + p.tau * theta_dot,
            theta_dot + p.tau * theta_acceleration,
        )
    )


def _has_failed(p: CartPoleParameters, state: NDArray[np.float64]) -> NDArray[np.bool_]:
    """``bool[A]``: the cart or the pole is out of bounds."""
    x, _, theta, _ = np.abs(state)
    return (x > p.x_threshold) | (theta > p.theta_threshold_radians)


def _observation(state: NDArray[np.float64]) -> NDArray[np.float32]:
    return np.array(state.T, dtype=np.float32, order="C")


def batched_cart_pole(environments: Sequence[gymnasium.Env[Any, Any]]) -> BatchedCartPole | None:
    """These environments as one, or None where that would not be the same (`obstacle_to_batch`)."""
    if any(obstacle_to_batch(environment) for environment in environments):
        return None
    parameters = {CartPoleParameters.of(cast("CartPole", environment)) for environment in environments}
    return BatchedCartPole(parameters.pop(), len(environments)) if len(parameters) == 1 else None


def obstacle_to_batch(environment: gymnasium.Env[Any, Any]) -> str | None:
    """Why an environment cannot be one of several that are played as arrays, in words; None where it can.

    It must be `CartPole` itself with nothing replaced, since a wrapper or a subclass may change anything, be shown to
    nobody, and play some hundred steps like its arrays.
    """
    if type(environment) is not CartPole:
        relation = "wrapped by" if isinstance(environment, gymnasium.Wrapper) else "it is not CartPole, but"
        return f"{relation} {type(environment).__name__}"
    if replaced := replacement_in(environment, CartPole):
        return replaced
    parameters = CartPoleParameters.of(environment)
    if environment.render_mode == "human" or parameters.kinematics_integrator != "euler":
        return "somebody looks on" if environment.render_mode == "human" else "its integrator is another one"
    if environment.action_space != spaces.Discrete(2) or environment.observation_space.shape != (4,):
        return f"its spaces {environment.observation_space} and {environment.action_space} are not those of CartPole"
    options = (*parameters, environment._sutton_barto_reward)
    if options not in _compared_already:
        alike = copy(environment)
        _compared_already[options] = plays_beside_its_batch(alike, BatchedCartPole(parameters, 1))
    difference = _compared_already[options]
    return difference and f"it differs from its arrays: found {difference}"
