"""Choosing APEL's one number, ν, from what you want, and checking the prediction.

    python examples/choosing_decay.py [EPISODES [RUNS]]

A large ν forgets quickly: a learner that becomes the best is soon found, but the best one also loses more episodes
to the others. The theory turns a wish into ν: here, that a new best learner is found within 200 episodes.
"""

import sys

import numpy as np

import apel
from apel.theory import selection_aware, selection_aware_inverses

WISH = 200.0  # episodes from the change until the new best is as likely as the old one


def found_after(decay: float, change: int, num_episodes: int, seed: int) -> int:
    """Episodes from the change until the second of two becomes as likely as the first one."""
    chooser = apel.Chooser(apel.Apel(decay=decay), 2, seed, num_episodes)
    for episode in range(num_episodes):
        chosen = chooser.select()
        chooser.observe((1.0, 0.0 if episode < change else 2.0)[chosen])
        first, second = chooser.concentration
        if episode >= change and second >= first:
            return episode - change
    return num_episodes - change


def main(num_episodes: int = 5000, num_runs: int = 50) -> tuple[float, float]:
    """From the wish to ν; then many runs."""
    decay = selection_aware_inverses.decay_for_adaptation_time(WISH, num_learners=2)
    share = selection_aware.exploration_probability(decay, num_learners=2)
    print(f"ν = {decay:.4f}; it costs {share:.1%} of the episodes, which the worse learner plays")
    times = [found_after(decay, num_episodes // 2, num_episodes, seed) for seed in range(1, num_runs + 1)]
    error = np.std(times) / np.sqrt(num_runs)
    print(f"wanted {WISH:.0f} episodes; measured {np.mean(times):.0f} ± {1.96 * error:.0f} in {num_runs} runs")
    return decay, float(np.mean(times))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
