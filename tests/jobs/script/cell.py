import gymnasium
import numpy as np

LENGTH = 6


class Bridge(gymnasium.Env):
    """A bridge of some cells."""

    def __init__(self):
        self.observation_space = gymnasium.spaces.Discrete(LENGTH)
        self.action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.cell = 0
        return 0, {}

    def step(self, action):
        self.cell = min(max(self.cell + (1 if action else -1), 0), LENGTH - 1)
        return self.cell, -1.0, self.cell == LENGTH - 1, False, {}


def make_env():
    return gymnasium.wrappers.TimeLimit(Bridge(), 40)


class Sarsa:
    """Expected SARSA."""

    off_policy = True

    def __init__(self, observation_space, action_space, seed, rate=0.2):
        self.rng, self.rate = np.random.default_rng(seed), rate
        self.table = np.zeros((observation_space.n, action_space.n))

    def policy(self, observation):
        best = self.table[observation] == self.table[observation].max()
        return 0.05 + 0.9 * best / best.sum()

    def act(self, observation):
        probability = self.policy(observation)
        return int(self.rng.choice(2, p=probability)), probability

    def learn(self, step):
        after = 0.0 if step.terminated else self.policy(step.next_observation) @ self.table[step.next_observation]
        value = self.table[step.observation]
        value[step.action] += self.rate * (step.reward + after - value[step.action])

    def end_episode(self):
        pass

    def state(self):
        return {"table": self.table.copy(), "rng": self.rng.bit_generator.state}

    def restore(self, state):
        self.table[:], self.rng.bit_generator.state = state["table"], state["rng"]
