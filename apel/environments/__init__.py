"""Domains, registered with Gymnasium under the namespace ``apel``."""

import gymnasium

from apel.environments.alike import alike
from apel.environments.batched import batched_environment, environment_list, way_of_play
from apel.environments.cartpole import CartPole
from apel.environments.closing import close_environments
from apel.environments.factory import World, make_world
from apel.environments.finite_environment import FiniteEnvironment
from apel.environments.joint_actions import JointActions
from apel.environments.maze import Maze

__all__ = [
    "CartPole",
    "FiniteEnvironment",
    "JointActions",
    "Maze",
    "World",
    "alike",
    "batched_environment",
    "close_environments",
    "environment_list",
    "make_world",
    "way_of_play",
]

# The maze truncates itself (its tables carry the limit), so that no TimeLimit wrapper is registered on top.
gymnasium.register(id="apel/Maze-v0", entry_point="apel.environments.maze:Maze")

# It ends its episodes and refuses steps outside of them itself: without any wrapper, `batched_environment` knows it.
gymnasium.register(
    id="apel/CartPole-v0",
    entry_point="apel.environments.cartpole:CartPole",
    reward_threshold=195.0,
    order_enforce=False,
)

# Each game is imported where it is made, with packages that not everybody installs. Both limit their episodes, and
# refuse steps outside of them, themselves.
gymnasium.register(
    id="apel/AtariBreakout-v0",
    entry_point="apel.environments.breakout.atari:AtariBreakout",
    order_enforce=False,
)
gymnasium.register(
    id="apel/MinAtarBreakout-v0",
    entry_point="apel.environments.breakout.minatar:MinAtarBreakout",
    order_enforce=False,
)
