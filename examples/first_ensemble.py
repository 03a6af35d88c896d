"""An ensemble on an environment of your own: two learners that see different things, and the agent that comes of them.

    python examples/first_ensemble.py [EPISODES]

The environment is a small stockroom. Every day one orders up to three pieces; customers take some; what lies there
costs, and so does a customer who leaves with nothing. The weekday decides how many customers come, and the weather
decides nothing. One learner sees stock, weekday and weather. The other one leaves the weather out, and so has a fifth
of the states to learn. Which of them is better, and when, the ensemble finds out while both learn.
"""

import sys
import tempfile
from pathlib import Path

import gymnasium
import numpy as np

import apel


class Stockroom(gymnasium.Env):
    """Four weeks of orders. Observation: pieces in stock (0 to 9), weekday (0 to 6), weather (0 to 4)."""

    def __init__(self):
        self.observation_space = gymnasium.spaces.MultiDiscrete([10, 7, 5])
        self.action_space = gymnasium.spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.stock, self.day = 3, 0
        return self._observation(), {}

    def step(self, action):
        wanted = int(self.np_random.poisson(3.0 if self.day % 7 >= 5 else 1.0))
        stock = min(self.stock + int(action), 9)
        sold = min(wanted, stock)
        reward = 1.0 * sold - 0.1 * stock - 0.5 * (wanted - sold)
        self.stock, self.day = stock - sold, self.day + 1
        return self._observation(), reward, self.day == 28, False, {}

    def _observation(self):
        return np.array([self.stock, self.day % 7, self.np_random.integers(5)])


def main(num_episodes: int = 2000, folder: Path | None = None) -> apel.Agent:
    """Train, say who played, save the agent, load it again and let it play a month."""
    environment = apel.EnvironmentConfig(Stockroom)
    options = {"learning_rate": 0.1, "exploration": 0.05, "discount": 0.95}
    learners = {
        "everything": apel.LearnerConfig("q_learning", options),
        "no weather": apel.LearnerConfig("q_learning", options, apel.Representation(exclude=(2,))),
    }
    world = apel.make_world(environment, run_seed=1)
    ensemble = apel.Ensemble(world, list(learners.values()), apel.Apel(decay=0.01), seed=1, num_episodes=num_episodes)
    records = list(ensemble.run())

    tenth = max(num_episodes // 10, 1)
    for title, part in (("first", records[:tenth]), ("last", records[-tenth:])):
        mean = np.mean([record.episode_return for record in part])
        share = np.mean([record.selected == 1 for record in part])
        print(f"{title} {tenth} episodes: mean return {mean:.2f}; 'no weather' played {share:.0%} of them")

    place = Path(folder or tempfile.mkdtemp()) / "stockkeeper"
    ensemble.agent(environment, list(learners)).save(place)
    agent = apel.load(place, acting="no weather", trust=True)  # trust: the environment is a class of ours
    room = Stockroom()
    observation, _ = room.reset(seed=7)
    total, ends = 0.0, False
    while not ends:
        observation, reward, ends, _, _ = room.step(agent.act(observation))
        total += reward
    print(f"the agent in {place} earns {total:.1f} in a month")
    return agent


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
