"""A deep learner beside a cheap one: DQN and a table over bins, on CartPole, and who of them is the better agent.

    python examples/deep_learners.py [EPISODES]

The table learns something at once and not much more; the network needs its time. What the table plays, the network
learns from, and the other way round. No PyTorch is needed. The first call compiles for a minute, later ones do not.
"""

import sys

import apel

BINS = (apel.Bins(-2.4, 2.4, 6), apel.Bins(-3.0, 3.0, 6), apel.Bins(-0.21, 0.21, 8), apel.Bins(-3.5, 3.5, 8))


def main(num_episodes: int = 400, num_evaluations: int = 20) -> apel.Evaluation:
    """Train both together, then let each play greedily on the same episodes."""
    environment = apel.EnvironmentConfig("CartPole-v1")
    dqn = {"total_steps": 20_000, "learning_starts": 200, "discount": 0.99, "network": {"hidden": [32]}}
    learners = {
        "table": apel.LearnerConfig("q_learning", {"discount": 0.99}, apel.Representation(bins=BINS)),
        "DQN": apel.LearnerConfig("dqn", {**dqn, "head_hidden": [32]}),
    }
    world = apel.make_world(environment, run_seed=5)
    ensemble = apel.Ensemble(world, list(learners.values()), apel.Apel(decay=0.02), seed=5, num_episodes=num_episodes)
    for record in ensemble.run():
        if (record.episode + 1) % max(num_episodes // 8, 1) == 0:
            probability = ", ".join(f"{p:.2f}" for p in record.probability)
            print(f"episode {record.episode + 1}: return {record.episode_return:.0f}; probabilities {probability}")

    evaluation = ensemble.agent(environment, list(learners)).evaluate(episodes=num_evaluations, seed=1)
    for played in evaluation.played:
        print(f"{played.learner}, {played.mode}: mean return {played.mean:.0f}")
    return evaluation


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
