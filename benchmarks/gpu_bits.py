"""How far a GPU's numbers are from a processor's, and from its own: ``python -m benchmarks.gpu_bits DEVICE``.

A part of `benchmarks.gpu`. Same parameters, inputs and gradients: relative errors of outputs (also against double
precision), of the first gradient and of what one step of Adam adds. Then whether some runs learn the same, bit for bit,
all together, once more, by threes and one by one; and whether PyTorch knows an operation among them that is not
deterministic. One line of JSON per network.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from apel.learners.deep.compiled_network import ONLINE, Descent
from apel.learners.deep.networks import Architecture, NetworkOptions, actor_critic, q_network, twin_q
from apel.learners.deep.stacked_network import StackedNetwork

RUNS, BATCH, STEPS = 6, 32, 30
DESCENT = Descent(1e-3, 1e-8, 10.0, by_variable=True)
ATARI = ((32, 8, 4), (64, 4, 2), (64, 3, 1))


def networks() -> dict[str, Architecture]:
    """Those of the shipped experiments."""
    relu = NetworkOptions(activation="relu")
    symbols = NetworkOptions(hidden=(128,), convolutions=((16, 4, 2),), activation="relu")
    frames = NetworkOptions(hidden=(), convolutions=ATARI, padding="same", activation="relu", initialisation="glorot")
    return {
        "dueling 256": q_network((4,), 2, relu, (256,), dueling=True),
        "actor-critic 256": actor_critic((4,), 2, NetworkOptions(hidden=(256,))),
        "twins 64-64": twin_q((4,), 2, relu),
        "MinAtar": q_network((4, 10, 10), 3, symbols),
        "Atari": q_network((4, 84, 84), 4, frames, (256,), dueling=True),
    }


def data(architecture: Architecture, step: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Inputs and gradients of all runs in one step."""
    generator = np.random.default_rng(step)
    size = RUNS, BATCH, int(np.prod(architecture.shape))
    slopes = generator.normal(size=(RUNS, BATCH, architecture.num_outputs)) / BATCH
    return generator.random(size, dtype=np.float32), slopes.astype(np.float32)


def learnt(architecture: Architecture, device: str, lanes: int, parts: list[list[int]], steps: int) -> Any:
    """State and last outputs after so many steps, of which each takes the runs in these parts."""
    network = StackedNetwork(architecture, range(RUNS), DESCENT, device, lanes, has_other=True)
    outputs = np.zeros((RUNS, BATCH, architecture.num_outputs), dtype=np.float32)
    for step in range(steps):
        inputs, slopes = data(architecture, step)
        for runs in [one_call for part in parts for one_call in network.calls(np.array(part))]:
            found = np.zeros_like(outputs[runs])
            network.predict(runs, BATCH, inputs[runs], found)
            network.descend(runs, BATCH, inputs[runs], slopes[runs])
            network.follow(runs, 0.01)
            network.evaluate(ONLINE, runs, BATCH, inputs[runs], found)
            outputs[runs] = found
    state = network.state()
    return {"outputs": outputs, "online": state["online"], "other": state["other"], **state["adam"]}


def distance(found: Any, expected: Any) -> float:
    """Norm of the difference, relative."""
    expected = np.asarray(expected, dtype=np.float64)
    return float(np.linalg.norm(np.asarray(found, dtype=np.float64) - expected) / np.linalg.norm(expected))


def errors(architecture: Architecture, device: str) -> dict[str, float]:
    """Of the device, relative to the processor's numbers."""
    inputs, _ = data(architecture, 0)
    here, there = (
        StackedNetwork(architecture, range(RUNS), DESCENT, each, RUNS, has_other=True) for each in ("cpu", device)
    )
    rows, given = here._online, torch.from_numpy(inputs)
    with torch.no_grad():
        exact = here.values(rows.double(), given.double()).numpy()
        ours = here.values(rows, given).numpy()
        theirs = there.values(there._online, given.to(device)).cpu().numpy()
    one, other = (learnt(architecture, each, RUNS, [list(range(RUNS))], 1) for each in ("cpu", device))
    start = rows.numpy()
    return {
        "outputs": distance(theirs, ours),
        "outputs, of double precision": distance(theirs, exact),
        "outputs, of double precision, processor": distance(ours, exact),
        "gradient": distance(other["exp_avg"], one["exp_avg"]),
        "one step of Adam": distance(other["online"] - start, one["online"] - start),
    }


def same_bits(architecture: Architecture, device: str, lanes: int) -> dict[str, Any]:
    """Whether it matters with whom a run is computed, or when."""
    steps = 5 if np.prod(architecture.shape) > 1_000 else STEPS
    everybody = list(range(RUNS))
    first = learnt(architecture, device, lanes, [everybody], steps)
    ways = {"again": [everybody], "threes": [[3, 4, 5], [0, 1, 2]], "alone": [[run] for run in everybody]}
    found = dict[str, Any]()
    for way, parts in ways.items():
        state = learnt(architecture, device, lanes, parts, steps)
        unlike = {name: distance(state[name], first[name]) for name in first if (state[name] != first[name]).any()}
        found[way] = unlike or "same"
    return found


def nondeterministic(architecture: Architecture, device: str) -> list[str]:
    """What PyTorch warns of in an update."""
    torch.use_deterministic_algorithms(True, warn_only=True)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            learnt(architecture, device, RUNS, [list(range(RUNS))], 1)
    finally:
        torch.use_deterministic_algorithms(False)
    return [str(one.message)[:200] for one in caught]


def measured(device: str) -> Iterator[dict[str, Any]]:
    """By network."""
    for name, architecture in networks().items():
        label = {"part": "bits", "network": name, "device": device}
        try:
            yield {**label, "errors": errors(architecture, device)}
            for lanes in (32, RUNS, 1):
                yield {**label, "lanes": lanes, "same": same_bits(architecture, device, lanes)}
            yield {**label, "warnings": nondeterministic(architecture, device)}
        except Exception as error:  # noqa: BLE001 - the others are still worth measuring
            yield {**label, "error": repr(error)}


if __name__ == "__main__":
    torch.set_num_threads(1)
    settings = {
        "torch": torch.__version__,
        "products in TF32 by default": torch.backends.cuda.matmul.allow_tf32,
        "cuDNN in TF32 by default": torch.backends.cudnn.allow_tf32,
    }
    print(json.dumps({"part": "settings", **settings}), flush=True)
    for one in measured(sys.argv[1]):
        print(json.dumps(one), flush=True)
