"""Domains, registered with Gymnasium under the namespace ``apel``."""

import gymnasium

from apel.environments.factory import World, make_world
from apel.environments.finite_environment import FiniteEnvironment
from apel.environments.maze import Maze

__all__ = ["FiniteEnvironment", "Maze", "World", "make_world"]

# The maze truncates itself (its tables carry the limit), so that no TimeLimit wrapper is registered on top.
gymnasium.register(id="apel/Maze-v0", entry_point="apel.environments.maze:Maze")
