"""Environments of other packages, where an id alone does not say enough."""

import gymnasium


def minigrid(name="MiniGrid-Empty-5x5-v0"):
    """A room of MiniGrid, seen as an image and without its mission, which is a text."""
    from minigrid.wrappers import ImgObsWrapper

    return ImgObsWrapper(gymnasium.make(name))


def minatar(game="space_invaders"):
    """Any game of MinAtar: asterix, breakout, freeway, seaquest, space_invaders."""
    from minatar.gym import BaseEnv

    return BaseEnv(game, use_minimal_action_set=True)
