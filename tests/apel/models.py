"""Small finite environments for tests."""

from __future__ import annotations

import numpy as np

from apel.configs import EnvironmentConfig
from apel.dynamics.finite_model import FiniteModel
from apel.environments import Maze, make_world


def lottery(max_steps: int = 20, num_distractors: int = 1) -> FiniteModel:
    """Three cells with chance in every place: two start cells, three outcomes per action, distractors of 5 values.

    Action 0 in cell 0 goes to the cells 0, 1, 2 with probabilities 1/2, 1/4, 1/4. All other actions go one cell on
    (modulo 3) with probability 3/4, and end the episode where they are with probability 1/4. Rewards tell outcomes
    apart.
    """
    next_cell = np.zeros((3, 2, 3), dtype=np.int32)
    cumulative = np.ones((3, 2, 3))
    reward = np.zeros((3, 2, 3))
    terminal = np.zeros((3, 2, 3), dtype=np.bool_)
    for cell in range(3):
        for action in range(2):
            next_cell[cell, action] = [(cell + 1) % 3, cell, 0]
            cumulative[cell, action] = [0.75, 1.0, 1.0]
            reward[cell, action] = [-1.0, 0.5 * (cell + action), 0.0]
            terminal[cell, action] = [False, True, False]
    next_cell[0, 0] = [0, 1, 2]
    cumulative[0, 0] = [0.5, 0.75, 1.0]
    reward[0, 0] = [0.125, 0.25, 0.375]
    terminal[0, 0] = False
    return FiniteModel(
        next_cell=next_cell,
        cumulative=cumulative,
        reward=reward,
        terminal=terminal,
        start_cell=np.array([0, 2], dtype=np.int32),
        start_cumulative=np.array([0.25, 1.0]),
        max_steps=max_steps,
        features=("cell", *(f"distractor_{i}" for i in range(num_distractors))),
        feature_sizes=(3, *[5] * num_distractors),
        num_distractors=num_distractors,
    )


def mazes(max_steps: int = 80) -> list[FiniteModel]:
    """Three small mazes with a distractor, of which two are one object."""
    one, two = (Maze(maze_seed=seed, size=5, distractors=(4,), max_steps=max_steps).finite_model for seed in (1, 2))
    return [one, two, one]


def frozen_lakes() -> list[FiniteModel]:
    """Three runs of FrozenLake."""
    model = make_world(EnvironmentConfig("FrozenLake-v1"), 0).model
    assert model is not None
    return [model] * 3
