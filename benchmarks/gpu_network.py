"""What an update of the network for Atari's parts take: ``python -m benchmarks.gpu_network DEVICE SECONDS``.

A part of `benchmarks.gpu`. Random frames, so that no game is needed, and the options of the experiment
``breakout-atari``. Milliseconds of wall time for all runs of a call together, medians; a GPU is waited for after each
call. One line of JSON per case.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from gymnasium import spaces

from apel.experience.frame_stacking import stacked_space
from apel.learners.banks.batched_learner import Transitions
from apel.learners.deep.dqn import BatchedDqn, sample, update
from apel.learners.deep.engines import OTHER
from apel.learners.deep.stacked_network import StackedNetwork
from apel.learners.deep.stacked_rows import clip_each_variable
from benchmarks.gpu_rates import shipped

STACK, SIDE, ACTIONS, REMEMBERED = 4, 84, 4, 200


def wait(device: str) -> None:
    """Until the GPU has nothing left to do."""
    if device != "cpu":
        torch.cuda.synchronize()


def milliseconds(call: Callable[[], object], device: str, seconds: float) -> float:
    """Median, after two calls to warm up, of as many as fit into the time, five at least."""
    taken = list[float]()
    until = time.perf_counter() + seconds
    while len(taken) < 7 or (time.perf_counter() < until and len(taken) < 200):
        wait(device)
        began = time.perf_counter()
        call()
        wait(device)
        taken.append(1e3 * (time.perf_counter() - began))
    return round(statistics.median(taken[2:]), 4)


def player(count: int, device: str, lanes: int) -> tuple[BatchedDqn, Callable[[], None], Callable[[], None]]:
    """Learners of that many runs with some steps in memory; what remembers one more step of each, and what acts."""
    options = {**shipped("cluster/breakout-atari"), "replay_size": 1_000, "learning_starts": 10**6}
    space = stacked_space(spaces.Box(0, 255, (SIDE, SIDE), np.uint8), STACK)
    learner = BatchedDqn(space, ACTIONS, list(range(count)), **options, device=device, lanes=lanes)
    runs, generator = np.arange(count), np.random.default_rng(1)
    frames = generator.integers(0, 256, (16, count, 1, SIDE, SIDE), dtype=np.uint8)
    seen = np.zeros((count, STACK, SIDE, SIDE), np.uint8)
    turn, never, even = 0, np.zeros(count, dtype=np.bool_), np.full((count, ACTIONS), 1.0 / ACTIONS)

    def remember() -> None:
        nonlocal seen, turn
        following = np.concatenate([seen[:, 1:], frames[turn % len(frames)]], axis=1)
        actions = generator.integers(ACTIONS, size=count)
        learner.learn(runs, Transitions(seen, actions, np.zeros(count), following, never, never, even))
        seen, turn = following, turn + 1

    for _ in range(REMEMBERED):
        remember()
    return learner, remember, lambda: learner.act(runs, seen)


def network_parts(network: Any, runs: Any, batch: Any, device: str, seconds: float) -> dict[str, float]:
    """Of PyTorch's networks: what goes to the device, passes, and the optimiser."""
    size, rows = batch.slots.shape[1], network._rows
    slope = np.random.default_rng(2).normal(size=batch.gradient.shape).astype(np.float32)
    given = rows.tensor(batch.inputs[: len(runs)])
    gradients = torch.zeros_like(rows.of(network._online, runs)).add_(1e-3)

    def both_passes() -> None:
        network.predict(runs, size, batch.inputs, batch.outputs)
        network.descend(runs, size, batch.inputs, slope)

    def passes_alone() -> None:
        variables = [one.detach().requires_grad_() for one in network.layout.unpack(rows.of(network._online, runs))]
        found = network._values(variables, given)
        torch.autograd.grad(found.sum(), variables)

    def forward_alone() -> None:
        with torch.no_grad():
            network.values(rows.of(network._online, runs), given)

    clip = clip_each_variable
    calls: dict[str, Callable[[], object]] = {
        "inputs to the device": lambda: rows.tensor(batch.inputs[: len(runs)]),
        "evaluate": lambda: network.evaluate(OTHER, runs, size, batch.next_inputs, batch.next_outputs),
        "predict and descend": both_passes,
        "forward alone": forward_alone,
        "forward and backward alone": passes_alone,
        "clipping": lambda: clip(gradients, network.layout, 10.0),
        "Adam": lambda: network._adam.step(runs, gradients),
    }
    if device != "cpu":
        pinned = torch.from_numpy(batch.inputs[: len(runs)]).pin_memory()
        calls["inputs to the device, pinned"] = lambda: pinned.to(device)
    return {name: milliseconds(call, device, seconds / len(calls)) for name, call in calls.items()}


def atari(count: int, device: str, lanes: int, seconds: float) -> dict[str, Any]:
    """Parts of a step and of an update of so many runs."""
    if device != "cpu":
        torch.cuda.reset_peak_memory_stats()
    learner, remember, act = player(count, device, lanes)
    runs, part = np.arange(count), seconds / 6
    arrays = learner.learner
    found: dict[str, Any] = {
        "remember": milliseconds(remember, device, part / 2),
        "act": milliseconds(act, device, part),
        "minibatch": milliseconds(lambda: sample(arrays.core, runs, arrays.batch), device, part),
    }
    is_stacked = isinstance(learner.acting, StackedNetwork)
    whole = update.py_func if is_stacked else update

    def updates() -> None:
        for each in learner.acting.calls(runs) if is_stacked else [runs[i : i + 1] for i in runs]:
            whole(arrays, each)

    found["update"] = milliseconds(updates, device, part)
    if is_stacked and lanes >= count:
        found |= network_parts(learner.acting, runs, arrays.batch, device, 2 * part)
    if device != "cpu":
        found["MiB at most"] = round(torch.cuda.max_memory_allocated() / 2**20)
        found["MiB reserved"] = round(torch.cuda.memory_reserved() / 2**20)
    return found


def measured(device: str, seconds: float) -> Iterator[dict[str, Any]]:
    """All cases that fit into the time."""
    until = time.perf_counter() + seconds
    cases = [(1, 1)] if device == "cpu" else [(1, 1), (4, 4), (16, 16), (1, 32)]
    for i, (count, lanes) in enumerate(cases):
        label = {"part": "atari", "runs": count, "lanes": lanes, "device": device}
        left = until - time.perf_counter()
        if left < 1.0:
            yield {**label, "error": "no time left"}
            continue
        try:
            share = min(0.6 * left / (len(cases) - i), 8.0)
            yield {**label, **atari(count, device, lanes, share)}
        except Exception as error:  # noqa: BLE001 - the others are still worth measuring
            yield {**label, "error": repr(error)}


if __name__ == "__main__":
    torch.set_num_threads(1)
    for one in measured(sys.argv[1], float(sys.argv[2])):
        print(json.dumps(one), flush=True)
