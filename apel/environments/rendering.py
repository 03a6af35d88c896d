"""An episode that was played, played once more for its pictures."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from apel.configs import EnvironmentConfig
from apel.environments.factory import World, make_world
from apel.environments.finite_environment import FiniteEnvironment
from apel.experience.action_form import ActionForm
from apel.experience.trajectory import Trajectory

_MODE = "rgb_array"


class Frame(NamedTuple):
    """What an environment looks like after some steps of an episode."""

    image: NDArray[np.uint8]
    """``uint8[height, width, 3]``."""
    step: int
    """Number of steps so far."""
    return_so_far: float


def rendered_world(config: EnvironmentConfig, run_seed: int, factory: Any = None) -> World:
    """The environment of a run as `make_world` makes it, ready to be drawn.

    It gets the option ``render_mode="rgb_array"`` besides its own.

    Raises
    ------
    ValueError
        If it cannot be rendered.
    """
    try:
        # Gymnasium warns of a mode that an environment does not have; that is said below.
        with warnings.catch_warnings(action="ignore"):
            drawn = replace(config, options={**config.options, "render_mode": _MODE})
            world = make_world(drawn, run_seed, factory)
    except ValueError as error:
        message = f"{config.name} cannot be rendered: {error}"
        raise ValueError(message) from error
    environment = world.environment
    if type(environment) is FiniteEnvironment:
        message = (
            f"{config.name} cannot be rendered: it is played from its tables, with other random numbers than its own"
        )
        raise ValueError(message)
    if environment.render_mode != _MODE:
        modes = environment.metadata.get("render_modes", [])
        message = f"{config.name} cannot be rendered: found the render modes {list(modes)}, expected {_MODE} among them"
        raise ValueError(message)
    _picture(environment)
    return world


def frames(world: World, episode: int, trajectory: Trajectory, every: int = 1) -> Iterator[Frame]:
    """The first state, every ``every``-th after it and the last one of an episode that was played in such a world.

    Raises
    ------
    ValueError
        If it does not go as ``trajectory`` says: the environment is no function of its seed and the actions.
    """
    environment = world.environment
    environment.reset(seed=world.seeds.of_episode(episode))
    yield Frame(_picture(environment), 0, 0.0)
    total, length = 0.0, len(trajectory)
    actions = ActionForm(environment.action_space).rows(trajectory.action)
    for step, (action, expected) in enumerate(zip(actions, trajectory.reward.tolist(), strict=True)):
        _, reward, terminated, truncated, _ = environment.step(action)
        total += float(reward)
        is_last, is_over = step + 1 == length, bool(terminated or truncated)
        if float(reward) != expected or is_over != is_last:
            message = (
                f"step {step} of episode {episode}, played again with the same seed and actions: found the reward "
                f"{reward} and {'an' if is_over else 'no'} end, expected {expected} and {'an' if is_last else 'no'} end"
            )
            raise ValueError(message)
        if is_last or (step + 1) % every == 0:
            yield Frame(_picture(environment), step + 1, total)


def _picture(environment: gymnasium.Env[Any, Any]) -> NDArray[np.uint8]:
    try:
        # A copy, for an environment may draw into the same array again.
        image = np.array(environment.render())
    except Exception as error:
        message = f"the environment cannot be rendered: {type(error).__name__}: {error}"
        raise ValueError(message) from error
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        found = f"{image.dtype}{list(image.shape)}"
        message = f"the environment cannot be rendered: found a picture {found}, expected uint8[height, width, 3]"
        raise ValueError(message)
    return image
