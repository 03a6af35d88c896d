"""A module that registers an environment with Gymnasium when it is imported."""

import gymnasium
from gymnasium.envs.toy_text import CliffWalkingEnv


class Cliff(CliffWalkingEnv):
    """Has a version in its id, and none in its import path."""


gymnasium.register("tests/Cliff-v3", entry_point=Cliff, max_episode_steps=11)
gymnasium.register("Unversioned", entry_point=Cliff, max_episode_steps=12)
