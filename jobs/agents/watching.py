"""A film of an episode that an agent plays now."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from apel.agents import Agent
from apel.agents.evaluation import check_spaces
from apel.building.registry import environment_factory
from apel.configs import EnvironmentConfig
from apel.environments import World, close_environments
from apel.environments.rendering import rendered_world
from apel.experience.trajectory import Trajectory
from apel.numerics.seeding import Role, make_key
from jobs.films.film import check_output
from jobs.films.watching import Film, FilmOptions, Shown, film_episode

_MOST_STEPS = 100_000


def film_agent(agent: Agent, config: EnvironmentConfig, options: FilmOptions, *, seed: int, explore: bool) -> Film:
    """Let the agent play an episode, greedily unless it is to ``explore``, and film it.

    Raises
    ------
    ValueError
        If the environment cannot be rendered, or has other spaces than the agent.
    SpecError
        If the file cannot be written.
    """
    path = options.output or Path(f"{agent.acting}-seed{seed}.gif")
    check_output(path)
    world = rendered_world(config, int(agent.content.origin.get("seed", 0)), environment_factory(config.id))
    try:
        check_spaces(agent.content, world)
        world = replace(world, key=make_key(seed, Role.EVALUATION))
        trajectory = _played(agent, world, explore=explore)
        shown = Shown(config.name, agent.now, 0, trajectory)
        every = film_episode(world, shown, replace(options, output=path))
    finally:
        close_environments([world.environment])
    return Film(path, agent.now, trajectory.undiscounted_return, len(trajectory), every, 0)


def _played(agent: Agent, world: World, *, explore: bool) -> Trajectory:
    environment = world.environment
    observation, info = environment.reset(seed=world.seeds.of_episode(0))
    agent.begin()
    actions, rewards, ends, cut = list[Any](), list[float](), False, False
    while not (ends or cut) and len(actions) < _MOST_STEPS:
        actions.append(agent.act(observation, explore=explore, info=info))
        observation, reward, ends, cut, info = environment.step(actions[-1])
        rewards.append(float(reward))
    if not (ends or cut):
        message = f"found no end of the episode within {_MOST_STEPS} steps, expected one: see max_episode_steps"
        raise ValueError(message)
    # Actions as their space has them: of a Box they are no whole numbers. What was seen, a Dict perhaps, no film needs.
    taken = np.array(actions, dtype=environment.action_space.dtype)
    return Trajectory(np.empty((len(taken) + 1, 0)), taken, np.array(rewards), terminated=bool(ends), probability=None)
