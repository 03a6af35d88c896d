"""Where the time of an update goes, and its arithmetic beside bare products of the same sizes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces

from apel.learners.banks.batched_learner import Transitions
from apel.learners.deep import dqn
from apel.learners.deep.passes import call_adam, call_backward, call_clip, call_forward
from apel.learners.deep.products import aligned, multiply
from apel.numerics.compiled import njit

NETWORKS: dict[str, dict[str, Any]] = {"64-64": {"dueling": False, "head_hidden": []}, "dueling 256": {}}
ONE = np.zeros(1, dtype=np.int64)


@njit
def _forward(times: int, a: Any, x: Any, out: Any) -> None:
    for _ in range(times):
        rooms = a.activations, a.patches, a.normalised
        call_forward(a.kernels.forward, (a.layers, a.maps, a.dueling, a.online[0], x, *rooms, out))


@njit
def _backward(times: int, a: Any, x: Any, slope: Any) -> None:
    for _ in range(times):
        rooms, found = (a.activations, a.patches, a.normalised), (a.deltas, a.transposed, a.gradient)
        call_backward(a.kernels.backward, (a.layers, a.maps, a.dueling, a.online[0], x, *rooms, slope, *found))


@njit
def _clip(times: int, a: Any) -> None:
    for _ in range(times):
        call_clip(a.kernels.clip, (a.layers, 1, 10.0, a.gradient))


@njit
def _adam(times: int, a: Any) -> None:
    for _ in range(times):
        call_adam(a.kernels.adam, (1000, 1e-9, 1e-8, a.gradient, a.online[0], a.mean[0], a.square[0]))


@njit
def _sample(times: int, core: Any, batch: Any, runs: Any) -> None:
    for _ in range(times):
        dqn.sample(core, runs, batch)


@njit
def _errors(times: int, batch: Any, chooser: Any, errors: Any) -> None:
    for _ in range(times):
        dqn.td_errors(1, batch, chooser, 1.0, errors)


@njit
def _product(times: int, rows: int, depth: int, columns: int, a: Any, b: Any, c: Any, y: Any) -> None:
    for _ in range(times):
        multiply(rows, depth, columns, a, 0, depth, 1, b, 0, columns, c, 0, 0, y, 0, columns)


def microseconds(call: Callable[..., None], *arguments: Any, times: int = 300) -> float:
    """Of one repetition: the best of seven, in processor time."""
    call(1, *arguments)
    best = np.inf
    for _ in range(7):
        began = time.process_time()
        call(times, *arguments)
        best = min(best, (time.process_time() - began) / times)
    return round(1e6 * best, 2)


def _learner(options: dict[str, Any]) -> dqn.BatchedDqn:
    network = {"activation": "relu", "initialisation": "pytorch"}
    space = spaces.Box(-np.inf, np.inf, (4,))
    learner = dqn.BatchedDqn(space, 2, [1], network=network, learning_starts=10**6, **options)
    rng, count = np.random.default_rng(1), 5_000
    seen, following = rng.normal(size=(2, count, 4))
    ends = rng.random((2, count)) < 0.02
    steps = Transitions(
        seen, rng.integers(2, size=count), rng.normal(size=count), following, ends[0], ends[1], np.full((count, 2), 0.5)
    )
    learner.learn(np.zeros(count, dtype=np.int64), steps)
    return learner


def _of_network(options: dict[str, Any]) -> dict[str, float]:
    learner = _learner(options)
    arrays: Any = learner.learner
    networks = arrays.network
    batch, size = arrays.batch, arrays.batch.slots.shape[1]
    slope = np.tanh(batch.inputs[0, :, :2]) * np.float32(0.01)
    times = {
        "sampling": microseconds(_sample, arrays.core, batch, ONE),
        "three forward passes": 3 * microseconds(_forward, networks, batch.inputs[0], batch.outputs[0]),
        "errors": microseconds(_errors, batch, arrays.chooser, arrays.errors),
        "backward pass": microseconds(_backward, networks, batch.inputs[0], slope),
        "clipping": microseconds(_clip, networks),
        "Adam": microseconds(_adam, networks),
        "choosing an action": microseconds(_forward, networks, batch.inputs[0, :1], batch.outputs[0, :1]),
    }
    # Three passes forward and, twice as much, one backward, without the first layer's gradient in its input.
    layers = networks.layers
    work = [2.0 * size * int(inputs) * int(outputs) for _, inputs, outputs in layers[:, :3]]
    flops = 3 * sum(work) + 2 * sum(work) - work[0]
    update = sum(value for name, value in times.items() if name != "choosing an action")
    arithmetic = times["three forward passes"] + times["backward pass"]
    return {
        **{f"{name}, µs": round(value, 2) for name, value in times.items()},
        "update, µs": round(update, 2),
        "Gflop/s of an update": round(flops / update / 1e3, 1),
        "Gflop/s of its passes": round(flops / arithmetic / 1e3, 1),
    }


def _bare(rows: int, depth: int, columns: int) -> float:
    arrays = [aligned(rows * depth), aligned(depth * columns), aligned(columns), aligned(rows * columns)]
    for array in arrays[:2]:
        array[:] = np.random.default_rng(1).normal(size=array.size)
    return round(2 * rows * depth * columns / microseconds(_product, rows, depth, columns, *arrays) / 1e3, 1)


def parts() -> dict[str, Any]:
    """Both networks of DQN, and Gflop/s of bare products."""
    products = {f"32 x {depth} x {columns}": _bare(32, depth, columns) for depth, columns in ((64, 64), (64, 256))}
    return {**{name: _of_network(options) for name, options in NETWORKS.items()}, "bare products, Gflop/s": products}
