"""Steps with training per second of processor time, of one kind: what `benchmarks.deep_engine` starts as a process.

It may run in an earlier version of this project, or beside JAX alone; so each kind imports what it needs by itself.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import sys
import time
from collections.abc import Callable
from typing import Any

SECONDS, WARM_UP, FOREVER = 6.0, 1_200, 10**6
# Where an installation of this project stands in for what an earlier version does not have, two would be mixed.
sys.meta_path = [finder for finder in sys.meta_path if "editable" not in repr(finder)]


def named(name: str, *modules: str) -> Any:
    """What one of these modules has, which one depending on the version."""
    for module in modules:
        with contextlib.suppress(ModuleNotFoundError):
            return getattr(importlib.import_module(module), name)
    message = f"found {name} in none of {modules}"
    raise ImportError(message)


def rate(play: Any) -> float:
    """``play()`` goes on for a while and answers with the steps so far; the first call has warmed up."""
    done, began = play(), time.process_time()
    while time.process_time() - began < SECONDS:
        steps = play()
    return (steps - done) / (time.process_time() - began)


def bank(learner: str, options: str, runs: str) -> float:
    """Some runs on CartPole in this process, as a learner's host plays them."""
    from apel.building import make_bank, make_performance, make_selector
    from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
    from apel.environments import make_world
    from apel.learners.base import StreakLimit

    run_seeds = named("run_seeds", "apel.numerics.seeding", "apel.seeding")
    open_book = named("open_book", "apel.run.opening", "apel.book")
    count = int(runs)
    seeds = run_seeds(1, count)
    worlds = [make_world(EnvironmentConfig("apel/CartPole-v0"), one) for one in seeds]
    config = LearnerConfig(learner, json.loads(options))
    learners = make_bank([config] * count, worlds, seeds, 0, make_performance("return"), with_probability=False)
    selector = make_selector(SelectorConfig("fixed"))
    book = open_book(selector, 1, FOREVER, None, seeds, [world.info for world in worlds])

    def play() -> int:
        while True:
            learners.play(range(count), book, selector, 0, StreakLimit(1_000, 200 * count), record=False)
            if book.steps.min() > WARM_UP:
                return int(book.steps.sum())

    return rate(play)


def ensemble(environment: str, options: str, runs: str) -> float:
    """Three learners of which APEL chooses, all of which learn from every step; hosts in this process."""
    from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
    from cluster.coordinator import Coordinator
    from cluster.local import LocalHosts
    from cluster.shard import ArmPlan, Execution, RunPlan, Shard

    run_seeds = named("run_seeds", "apel.numerics.seeding", "apel.seeding")
    bins_of, representation = (
        named(name, "apel.experience.representations", "apel.representations") for name in ("Bins", "Representation")
    )
    is_maze = "Maze" in environment
    edges = ((-2.4, 2.4, 2), (-3, 3, 2), (-0.21, 0.21, 6), (-3.5, 3.5, 4))
    view = representation() if is_maze else representation(bins=tuple(bins_of(*each) for each in edges))
    learners = (LearnerConfig("q_learning", {}, view), LearnerConfig("dqn"), LearnerConfig("acer"))
    config = EnvironmentConfig(environment, json.loads(options), run_seed="maze_seed" if is_maze else None)
    plans = tuple(RunPlan(i, seed, config, learners) for i, seed in enumerate(run_seeds(1, int(runs))))
    names, steps = ("Q", "DQN", "ACER"), 6_000
    arm = ArmPlan("rates", "APEL", "", names, SelectorConfig("apel"), "return", 1_000, num_steps=steps)
    store = Nowhere()
    began = time.process_time()
    for _ in Coordinator(LocalHosts(), store, store, Execution()).run(Shard(arm, plans)):
        pass
    return len(plans) * steps / (time.process_time() - began)


class Nowhere:
    """Keeps nothing."""

    def read(self, _: Any) -> None:
        """Nothing."""

    def __getattr__(self, _: str) -> Any:
        return lambda *_: ""


def stable_baselines(name: str) -> float:
    """One run of stable-baselines3's DQN; it has no dueling network, the nearest is one more layer of 256."""
    import gymnasium
    import torch
    from stable_baselines3 import DQN
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)

    class Clock(BaseCallback):
        began, counted_from = 0.0, 0

        def _on_step(self) -> bool:
            if not self.began and self.num_timesteps >= WARM_UP:
                self.began, self.counted_from = time.process_time(), self.num_timesteps
            return not self.began or time.process_time() - self.began < SECONDS

    model = DQN(
        "MlpPolicy",
        gymnasium.make("CartPole-v1", max_episode_steps=200),
        learning_rate=5e-4,
        buffer_size=50_000,
        learning_starts=1_000,
        batch_size=32,
        gamma=1.0,
        train_freq=1,
        target_update_interval=500,
        exploration_final_eps=0.02,
        policy_kwargs={"net_arch": [64, 64, *([256] if "dueling" in name else [])]},
        seed=1,
        device="cpu",
    )
    clock = Clock()
    model.learn(100_000, callback=clock)
    return (model.num_timesteps - clock.counted_from) / (time.process_time() - clock.began)


def single_file(name: str) -> float:
    """One run of the code in one file."""
    from benchmarks.single_file_dqn import steps_per_second

    return steps_per_second(1, SECONDS, dueling="dueling" in name)


def rejax(name: str) -> float:
    """One run of rejax's DQN, compiled as a whole; steps after the first call. Its network is always 64-64."""
    import jax  # type: ignore[import-not-found, unused-ignore]
    from rejax import DQN  # type: ignore[import-not-found, unused-ignore]

    if "dueling" in name:
        message = "rejax's DQN has no other network than 64-64"
        raise ValueError(message)
    steps = 20_000
    agent = DQN.create(
        env="CartPole-v1",
        agent_kwargs={"activation": "relu"},
        learning_rate=5e-4,
        buffer_size=50_000,
        batch_size=32,
        gamma=1.0,
        num_envs=1,
        num_epochs=1,
        target_update_freq=500,
        fill_buffer=1_000,
        eval_freq=steps,
        total_timesteps=steps,
    )
    train = jax.jit(agent.train)
    jax.block_until_ready(train(jax.random.PRNGKey(0)))
    began = time.process_time()
    jax.block_until_ready(train(jax.random.PRNGKey(1)))
    return steps / (time.process_time() - began)


KINDS: dict[str, Callable[..., float]] = {
    "bank": bank,
    "ensemble": ensemble,
    "stable-baselines3": stable_baselines,
    "single file": single_file,
    "rejax": rejax,
}

if __name__ == "__main__":
    print(KINDS[sys.argv[1]](*sys.argv[2:]))
