"""A learner of your own in an ensemble: Expected SARSA beside Q-learning, on a cliff.

    python examples/own_learner.py [EPISODES]

Q-learning learns the shortest path along the cliff and falls off while it explores; Expected SARSA learns to keep away
from the edge. Each learns from what the other one did. In the end the ensemble lets the one play that earns more.
"""

import sys
from collections import defaultdict

import numpy as np

import apel


class ExpectedSarsa:
    """Learns the values of its own ε-greedy policy. These methods are all that a learner needs."""

    off_policy = True  # it can learn from episodes that another learner played

    def __init__(self, observation_space, action_space, seed, learning_rate=0.5, exploration=0.1):
        self.rng, self.rate, self.exploration = np.random.default_rng(seed), learning_rate, exploration
        self.table = defaultdict(lambda: np.zeros(action_space.n))

    def policy(self, observation):
        values = self.table[observation]
        best = values == values.max()
        return self.exploration / len(values) + (1 - self.exploration) * best / best.sum()

    def act(self, observation):
        probability = self.policy(observation)
        return int(self.rng.choice(len(probability), p=probability)), probability

    def learn(self, step):
        # A truncated step is not terminated: its next state still has a value.
        after = 0.0 if step.terminated else self.policy(step.next_observation) @ self.table[step.next_observation]
        values = self.table[step.observation]
        values[step.action] += self.rate * (step.reward + after - values[step.action])

    def end_episode(self):
        pass

    def state(self):
        return {"table": dict(self.table), "rng": self.rng.bit_generator.state}

    def restore(self, state):
        self.table.clear()
        self.table.update(state["table"])
        self.rng.bit_generator.state = state["rng"]


def main(num_episodes: int = 500) -> list[apel.EpisodeRecord]:
    """Train both together; say what each earns when it plays."""
    world = apel.make_world(apel.EnvironmentConfig("CliffWalking-v1", max_episode_steps=200), run_seed=3)
    learners = {
        "Q-learning": apel.LearnerConfig("q_learning", {"learning_rate": 0.5, "exploration": 0.1}),
        "Expected SARSA": apel.LearnerConfig(ExpectedSarsa, {"learning_rate": 0.5}),
    }
    ensemble = apel.Ensemble(world, list(learners.values()), apel.Apel(decay=0.02), seed=3, num_episodes=num_episodes)
    records = list(ensemble.run())
    last = records[num_episodes // 2 :]
    for index, name in enumerate(learners):
        returns = [record.episode_return for record in last if record.selected == index]
        mean = f"mean return {np.mean(returns):.1f}" if returns else "no return"
        print(f"{name}: {len(returns)} of the last {len(last)} episodes, {mean}")
    return records


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
