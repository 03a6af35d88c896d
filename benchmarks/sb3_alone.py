"""The learners of stable-baselines3 that an experiment names, each alone and without this project.

::

    python -m benchmarks.sb3_alone pendulum --steps 4000 --seeds 2

Of each: the mean return of the episodes in the last tenth of the steps, as while it is trained, and of twenty greedy
ones.
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import NormalActionNoise
from torch import set_num_threads

from jobs.experiment.spec_files import load_experiment
from jobs.results.manifest import versions

RESULTS = Path("benchmarks/results/sb3_alone.json")
_EPISODES = 20


def main() -> None:
    """Print and store."""
    parser = argparse.ArgumentParser()
    parser.add_argument("experiment")
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--seeds", type=int, default=2)
    arguments = parser.parse_args()
    set_num_threads(1)
    experiment = load_experiment(arguments.experiment)
    found = []
    for name, learner in experiment.learners.items():
        if "algorithm" in learner.options:
            for seed in range(arguments.seeds):
                environment = gymnasium.make(experiment.environment.id, **experiment.environment.options)
                result = {"learner": name, "seed": seed, **trained(learner.options, environment, arguments.steps, seed)}
                print(result, flush=True)
                found.append(result)
    stored = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    measured = {**stored.get("measured", {}), arguments.experiment: {"steps": arguments.steps, "runs": found}}
    RESULTS.write_text(json.dumps({"versions": versions(), "measured": measured}, indent=1) + "\n")


def trained(options: dict[str, Any], environment: gymnasium.Env[Any, Any], steps: int, seed: int) -> dict[str, float]:
    """Train for ``steps``, and measure."""
    module, name = options["algorithm"].split(":")
    rest = {key: value for key, value in options.items() if key not in ("algorithm", "total_timesteps")}
    if "action_noise" in rest:
        zeros = np.zeros(environment.action_space.shape or ())
        rest["action_noise"] = NormalActionNoise(zeros, zeros + rest["action_noise"]["sigma"])
    monitor = Monitor(environment)
    model = getattr(importlib.import_module(module), name)("MlpPolicy", monitor, seed=seed, device="cpu", **rest)
    began = time.perf_counter()
    model.learn(steps)
    seconds = time.perf_counter() - began
    ends = np.cumsum(monitor.get_episode_lengths())
    late = np.array(monitor.get_episode_rewards())[ends > 0.9 * steps]
    greedy, _ = evaluate_policy(model, monitor, _EPISODES, deterministic=True)
    return {"last_tenth_return": float(late.mean()), "greedy_return": float(greedy), "seconds": round(seconds, 1)}


if __name__ == "__main__":
    main()
