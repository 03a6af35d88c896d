"""What it costs to tell every learner of Atari frames: by reference, as this project does, and with copies.

``python -m benchmarks.pixels``. Needs the extras deep and atari. Two things are measured in one run: how long it takes
until another process has read the steps of one round (real frames, 1000 steps, Ray actors on this machine), and what a
step costs altogether in the ensemble of ``breakout-atari`` (Q-learner and DQN, updates included, on the CPU).

* by reference: the host puts the batch into the object store, the coordinator passes its reference on, and the reader
  maps it into its memory: one copy in all, that into the store.
* copied by the coordinator: it takes the batch, and sends it on: what happens where references are not passed on.
* stacked: by reference, but each step with both of its stacks of four frames, as transitions mostly travel.
* stacked and copied: both, which is what a plain program does.

The parts of a step of the DQN are measured one by one too, in this process and on one core: what a GPU would take
over, and what not.
"""

from __future__ import annotations

import copy
import json
import pickle
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import ray
import torch
from gymnasium import spaces

from apel.configs import EnvironmentConfig
from apel.environments import make_world
from apel.experience.frame_stacking import stacked_space
from apel.experience.trajectory import Episodes, Trajectory, TrajectoryBatch, batch_of
from apel.learners.banks.batched_learner import Transitions
from apel.learners.deep.dqn import BatchedDqn, sample, update
from cluster.launch import ray_cluster
from jobs.experiment.spec_files import load_experiment
from jobs.results.manifest import versions
from jobs.runner import Settings, run_experiment

STEPS, ROUNDS, PIPELINE_STEPS, STACK = 1000, 15, 6_000, 4


def played_batch(steps: int) -> TrajectoryBatch:
    """Steps of random play, cut off as one episode."""
    world = make_world(EnvironmentConfig("apel/AtariBreakout-v0"), 1)
    generator = np.random.default_rng(1)
    observation, _ = world.environment.reset(seed=1)
    entries = [np.array(observation)]
    for step in range(steps):
        observation, _, terminated, *_ = world.environment.step(int(generator.integers(4)))
        if terminated:
            observation, _ = world.environment.reset(seed=step)
        entries.append(np.array(observation))
    row = Episodes._make(np.array([value]) for value in (0, 0, steps, 0.0, 0.0, 0.0, False))
    trajectory = Trajectory(np.stack(entries), np.zeros(steps, np.int8), np.zeros(steps), False)
    return batch_of(row, [trajectory])


def stacked(batch: TrajectoryBatch) -> TrajectoryBatch:
    """The same steps, each with the stack before it and the stack after it."""
    frames = batch.observation["frame"]
    first = np.maximum(np.arange(len(frames) - 1)[:, None] + np.arange(1 - STACK, 1), 0)
    return replace(batch, observation=np.stack([frames[first], frames[first + 1]], axis=1))


class Player:
    """Has played."""

    def __init__(self, batch: TrajectoryBatch) -> None:
        self._batch = batch

    def play(self) -> TrajectoryBatch:
        """What it played, not the same object twice."""
        return copy.deepcopy(self._batch)


class Reader:
    """Learns from what others played."""

    def read(self, batch: TrajectoryBatch) -> int:
        """Look at every byte."""
        return int(np.ascontiguousarray(batch.observation).view(np.uint8).sum(dtype=np.int64))


def by_reference(player: Any, reader: Any) -> None:
    """One round."""
    ray.get(reader.read.remote(player.play.remote()))


def with_copies(player: Any, reader: Any) -> None:
    """One round in which the batch goes through the coordinator."""
    taken: TrajectoryBatch = pickle.loads(pickle.dumps(ray.get(player.play.remote())))
    ray.get(reader.read.remote(taken))


def seconds_per_step(batch: TrajectoryBatch, one_round: Callable[[Any, Any], None]) -> float:
    """Median over rounds, of a batch that another process plays and a third reads, less what both do without any
    transport.
    """
    player = ray.remote(num_cpus=0)(Player).remote(batch)
    reader = ray.remote(num_cpus=0)(Reader).remote()
    taken = []
    for _ in range(ROUNDS + 2):
        began = time.perf_counter()
        one_round(player, reader)
        taken.append(time.perf_counter() - began)
    local = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        Reader().read(Player(batch).play())
        local.append(time.perf_counter() - began)
    ray.kill(player)
    ray.kill(reader)
    return (float(np.median(taken[2:])) - float(np.median(local))) / STEPS


def pipeline_seconds_per_step(folder: str) -> float:
    """Of the ensemble with Ray actors: ε and updates as in its first 6 000 of 20 000 steps, updates after 2 000."""
    overrides = [
        "runs=1", f"steps={PIPELINE_STEPS}", "learners.DQN.learning_starts=2000", "learners.DQN.total_steps=20000",
        "learners.DQN.device=cpu", "learners.DQN.num_gpus=0",
    ]  # fmt: skip
    settings = Settings(results=folder, placement="actors", arms=("APEL",), fresh=True, dashboard=False)
    outcome = run_experiment(load_experiment("breakout-atari", overrides), settings)
    return outcome.seconds / int(outcome.store.runs()["steps"][0].as_py())


def seconds_of_parts() -> dict[str, float]:
    """Of one step of one run: the game, remembering, choosing an action; and of one update, all and without network."""
    torch.set_num_threads(1)
    experiment = load_experiment("breakout-atari", ["learners.DQN.device=cpu", "learners.DQN.learning_starts=1000"])
    world = make_world(EnvironmentConfig("apel/AtariBreakout-v0"), 1)
    space = stacked_space(spaces.Box(0, 255, (84, 84), np.uint8), STACK)
    learner = BatchedDqn(space, 4, [1], **experiment.learners["DQN"].options)
    run, generator = np.zeros(1, dtype=np.int64), np.random.default_rng(1)
    world.environment.reset(seed=1)
    seen, steps = np.zeros((1, STACK, 84, 84), np.uint8), []

    def play() -> None:
        entry, reward, terminated, *_ = world.environment.step(int(generator.integers(4)))
        before = steps[-1].next_observation if steps else seen
        following = np.concatenate([before[:, 1:], entry["frame"][None, None]], axis=1)
        ends = np.array([terminated]), np.array([False])
        steps.append(Transitions(before, run, np.array([reward]), following, *ends, np.full((1, 4), 0.25)))
        if terminated:
            world.environment.reset(seed=len(steps))

    def timed(call: Callable[[], object], times: int) -> float:
        began = time.perf_counter()
        for _ in range(times):
            call()
        return (time.perf_counter() - began) / times

    found = {"game": timed(play, 600)}
    pending = iter(steps)
    found["remember"] = timed(lambda: learner.learn(run, next(pending)), 500)
    found["act"] = timed(lambda: learner.act(run, steps[-1].observation), 200)
    found["minibatch"] = timed(lambda: sample(learner.learner.core, run, learner.learner.batch), 100)
    found["update"] = timed(lambda: update.py_func(learner.learner, run), 30)
    return found


def main() -> None:
    """Print and store."""
    batch = played_batch(STEPS)
    whole = stacked(batch)
    cases = {
        "by reference": (batch, by_reference),
        "copied by the coordinator": (batch, with_copies),
        "stacked": (whole, by_reference),
        "stacked and copied": (whole, with_copies),
    }
    with ray_cluster(dashboard=False):
        found = {
            name: {"bytes_per_step": one.nbytes / STEPS, "seconds_per_step": seconds_per_step(one, how)}
            for name, (one, how) in cases.items()
        }
        total = pipeline_seconds_per_step("/tmp/apel-benchmark-pixels")
    parts = seconds_of_parts()
    base = found["by reference"]
    for name, one in found.items():
        ratios = [one[key] / base[key] for key in ("bytes_per_step", "seconds_per_step")]
        print(
            f"{name:26} {one['bytes_per_step']:9,.0f} bytes, {1e6 * one['seconds_per_step']:7.1f} µs per step"
            f" ({ratios[0]:.1f} × and {ratios[1]:.1f} ×), {one['seconds_per_step'] / total:6.2%} of a step's wall time"
        )
    print(f"a step of the ensemble: {1e3 * total:.1f} ms")
    print("parts, ms: " + ", ".join(f"{name} {1e3 * seconds:.2f}" for name, seconds in parts.items()))
    stored = {"versions": versions(), "transport": found, "pipeline_seconds_per_step": total, "parts": parts}
    Path("benchmarks/results/pixels.json").write_text(json.dumps(stored, indent=2) + "\n")


if __name__ == "__main__":
    main()
