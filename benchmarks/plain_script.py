"""What a user would write without this project: a Gymnasium environment, a NumPy table, a loop.

It plays the same maze with the same learners; only its random numbers differ.
"""

from __future__ import annotations

import gymnasium
import numpy as np

import apel.environments  # noqa: F401 - registers apel/Maze-v0


class PlainQ:
    """Q-learning on a table that has one axis per visible feature."""

    def __init__(self, visible: list[int], rng: np.random.Generator) -> None:
        self.visible = visible
        self.table = np.zeros((*[10] * len(visible), 4))
        self.rng = rng

    def act(self, observation: np.ndarray) -> int:
        """ε-greedy with uniform tie-breaking."""
        if self.rng.random() < 0.1:
            return int(self.rng.integers(4))
        values = self.table[tuple(observation[self.visible])]
        return int(self.rng.choice(np.flatnonzero(values == values.max())))

    def learn(self, observation: np.ndarray, action: int, reward: float, following: np.ndarray, end: bool) -> None:
        """Eq. 2.8."""
        value = 0.0 if end else self.table[tuple(following[self.visible])].max()
        key = (*observation[self.visible], action)
        self.table[key] += 0.1 * (reward + value - self.table[key])


def play(seed: int, arm: str, num_episodes: int) -> int:
    """Play one run of the arm ``Q_full`` or ``APEL``; returns the number of environment steps."""
    rng = np.random.default_rng(seed)
    environment = gymnasium.make("apel/Maze-v0", maze_seed=seed, distractors=[10], optimal_length=[33, 35])
    learners = [PlainQ([0, 1, 2], rng)]
    if arm == "APEL":
        dropped = int(rng.integers(3))
        learners.append(PlainQ([i for i in range(3) if i != dropped], rng))
    concentration = np.ones(len(learners))
    estimate = np.full(len(learners), np.nan)
    num_steps = 0
    for episode in range(num_episodes):
        selected = int(rng.choice(len(learners), p=rng.dirichlet(concentration)))
        observation, _ = environment.reset(seed=seed + episode)
        total, end = 0.0, False
        while not end:
            action = learners[selected].act(observation)
            following, reward, terminated, truncated, _ = environment.step(action)
            for learner in learners:
                learner.learn(observation, action, float(reward), following, terminated)
            observation, total, end = following, total + float(reward), terminated or truncated
            num_steps += 1
        estimate[selected] = total
        if len(learners) > 1 and total > np.delete(estimate, selected).max():
            concentration[selected] += 1
        concentration = np.maximum(concentration * 0.99, 1)
    return num_steps
