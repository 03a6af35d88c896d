"""A selector of your own, held against shipped ones: how soon each finds the best of five, and at what price.

    python examples/own_selector.py [EPISODES [RUNS]]

Selectors need no environment. Whatever has a score can stand in a learner's place: solvers, prompts, hyperparameters.
Here five of them score around known means, and the best one gets worse half-way. The regret counts what was missed.
"""

import sys
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import apel


@dataclass(frozen=True)
class SoftmaxOfMeans:
    """Draws in proportion to exp(mean / temperature), with exponential means of what each has scored."""

    temperature: float = 0.1
    rate: float = 0.1
    fields: ClassVar = {"mean": 1.0}  # what it remembers: one number per learner, optimistic at first

    def select(self, state, rng):
        weight = np.exp((state.mean - state.mean.max()) / self.temperature)
        state.probability[:] = weight / weight.sum()
        return rng.choice(len(weight), p=state.probability)

    def observe(self, state, selected, performance):
        state.mean[selected] += self.rate * (performance - state.mean[selected])


def regret(selector, num_episodes: int, seed: int) -> float:
    """What a selector misses over the episodes, compared with always taking the best of the moment."""
    chooser, rng = apel.Chooser(selector, 5, seed, num_episodes), np.random.default_rng(seed)
    means, missed = np.array([0.3, 0.4, 0.5, 0.6, 0.8]), 0.0
    for episode in range(num_episodes):
        if episode == num_episodes // 2:
            means[-1] = 0.2
        chosen = chooser.select()
        chooser.observe(means[chosen] + 0.1 * rng.normal())
        missed += means.max() - means[chosen]
    return missed


def main(num_episodes: int = 1000, num_runs: int = 20) -> dict[str, float]:
    """Mean regret of each selector."""
    selectors = {
        "softmax of means": SoftmaxOfMeans(),
        "APEL": apel.Apel(decay=0.02),
        "SSBAS": apel.Ssbas(),
        "UCB1": apel.Ucb1(),
        "uniform": apel.Uniform(),
    }
    found = {}
    for name, selector in selectors.items():
        found[name] = float(np.mean([regret(selector, num_episodes, seed) for seed in range(1, num_runs + 1)]))
        print(f"{name}: {found[name]:.1f} missed in {num_episodes} episodes")
    return found


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
