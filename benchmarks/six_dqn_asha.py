"""Ray Tune's ASHA over the six DQN configurations of docs/examples/six-dqn-*.yaml, trained by stable-baselines3.

::

    python -m benchmarks.six_dqn_asha cartpole acrobot --repetitions 3

Each repetition may take as many environment steps, all trials together, as one run of the ensemble takes; then Tune
stops whatever is still being trained. Its recommendation is the trial with the highest mean return over its latest
twenty episodes. That trial's network plays greedy episodes.
"""

from __future__ import annotations

import argparse
import json
import random
import tempfile
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import ray
from ray import tune
from ray.tune.schedulers import ASHAScheduler
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn, set_num_threads

import apel.environments  # noqa: F401 - registers apel/CartPole-v0
from jobs.experiment.spec_files import load_experiment
from jobs.results.manifest import versions

RESULTS = Path("benchmarks/results/six_dqn_asha.json")
_EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
_GRACE, _REDUCTION, _REPORT, _EPISODES = 1500, 3, 500, 50


class Reports(BaseCallback):
    """Tells Tune every 500 steps how it goes, and keeps the network."""

    def _on_step(self) -> bool:
        if self.num_timesteps % _REPORT == 0:
            latest = [episode["r"] for episode in list(self.model.ep_info_buffer or [])[-20:]]
            with tempfile.TemporaryDirectory() as folder:
                self.model.save(Path(folder, "model.zip"))
                metrics = {"steps": self.num_timesteps, "mean_return": float(np.mean(latest)) if latest else -1e9}
                tune.report(metrics, checkpoint=tune.Checkpoint.from_directory(folder))
        return True


class StepBudget(tune.Stopper):
    """Ends the search when all trials together have taken so many environment steps."""

    def __init__(self, budget: int) -> None:
        self.budget = budget
        self.steps: dict[str, int] = {}

    def __call__(self, trial_id: str, result: dict[str, Any]) -> bool:
        """Count; a single trial is never ended here."""
        self.steps[trial_id] = int(result["steps"])
        return False

    def stop_all(self) -> bool:
        """Whether the budget is spent."""
        return sum(self.steps.values()) >= self.budget


def six_configurations(task: str) -> tuple[str, int, dict[str, dict[str, Any]]]:
    """The environment, a run's steps, and stable-baselines3's words for the six learners of a shipped example."""
    experiment = load_experiment(str(_EXAMPLES / f"six-dqn-{task}.yaml"))
    steps = int(experiment.steps or 0)
    learners = {name: learner.options for name, learner in experiment.learners.items()}
    return experiment.environment.id, steps, {name: as_sb3(options) for name, options in learners.items()}


def as_sb3(options: dict[str, Any]) -> dict[str, Any]:
    """The same DQN; what the example leaves out is the default of `DqnOptions`."""
    return {
        "learning_rate": options["learning_rate"],
        "gamma": options["discount"],
        "learning_starts": options["learning_starts"],
        "hidden": list(options["network"]["hidden"]),
        "total_steps": options["total_steps"],
    }


def train(config: dict[str, Any]) -> None:
    """One trial, until Tune ends it."""
    set_num_threads(1)
    options = config["configurations"][config["name"]]
    model = DQN(
        "MlpPolicy",
        # This function travels without its module: what registers the environment is named with it.
        gymnasium.make(f"apel.environments:{config['environment']}"),
        seed=config["seed"],
        device="cpu",
        learning_rate=options["learning_rate"],
        gamma=options["gamma"],
        learning_starts=options["learning_starts"],
        buffer_size=50_000,
        batch_size=32,
        train_freq=1,
        target_update_interval=500,
        exploration_fraction=0.1,
        exploration_final_eps=0.02,
        policy_kwargs={"net_arch": options["hidden"], "activation_fn": nn.ReLU},
    )
    model.learn(options["total_steps"], callback=Reports())


def greedy_return(path: Path, environment: str) -> float:
    """Mean over episodes of a stored network."""
    model, played = DQN.load(path, device="cpu"), gymnasium.make(environment)
    returns = []
    for episode in range(_EPISODES):
        observation, _ = played.reset(seed=1_000_000 + episode)
        total, ended = 0.0, False
        while not ended:
            action, _ = model.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, _ = played.step(int(action))
            total, ended = total + float(reward), terminated or truncated
        returns.append(total)
    return float(np.mean(returns))


def search(task: str, repetition: int) -> dict[str, Any]:
    """One repetition: what is recommended, what it is worth, and what it took."""
    environment, budget, configurations = six_configurations(task)
    names = list(configurations)
    random.Random(repetition).shuffle(names)
    stopper, began = StepBudget(budget), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        grid = tune.Tuner(
            train,
            param_space={
                "name": tune.grid_search(names),
                "configurations": configurations,
                "environment": environment,
                "seed": repetition,
            },
            tune_config=tune.TuneConfig(
                metric="mean_return",
                mode="max",
                scheduler=ASHAScheduler(
                    time_attr="steps", grace_period=_GRACE, reduction_factor=_REDUCTION, max_t=budget
                ),
                reuse_actors=True,
            ),
            run_config=tune.RunConfig(storage_path=folder, stop=stopper, verbose=0),
        ).fit()
        seconds = time.perf_counter() - began
        best = grid.get_best_result()
        with best.checkpoint.as_directory() as kept:
            value = greedy_return(Path(kept, "model.zip"), environment)
    trials = {one.config["name"]: one.metrics.get("steps", 0) for one in grid if one.config and one.metrics}
    return {
        "task": task,
        "repetition": repetition,
        "learner": best.config["name"],
        "greedy_return": value,
        "steps": sum(trials.values()),
        "trial_steps": trials,
        "seconds": round(seconds, 1),
    }


def main() -> None:
    """Print and store, repetition by repetition."""
    parser = argparse.ArgumentParser()
    parser.add_argument("tasks", nargs="+")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="Of the repetitions.")
    parser.add_argument("--cpus", type=int, default=2, help="Trials that are trained at the same time.")
    arguments = parser.parse_args()
    ray.init(num_cpus=arguments.cpus, include_dashboard=False, log_to_driver=False)
    for repetition in range(arguments.first, arguments.first + arguments.repetitions):
        for task in arguments.tasks:
            found = search(task, repetition)
            print(found, flush=True)
            stored = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"searches": []}
            known = [one for one in stored["searches"] if (one["task"], one["repetition"]) != (task, repetition)]
            content = {"versions": versions(), "greedy_episodes": _EPISODES, "searches": [*known, found]}
            RESULTS.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
