"""The compiled engine's gradients and steps against PyTorch's autograd and optimisers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from apel.learners.deep.compiled_network import ONLINE, OTHER, CompiledNetwork, Descent
from apel.learners.deep.networks import Architecture, NetworkOptions, actor_critic, q_network, twin_q
from apel.learners.deep.stacked_network import StackedNetwork
from tests.apel.learners.deep.steps import runs_of
from tests.apel.learners.deep.tables import Values

NETWORKS = {
    "q": q_network((4,), 2, NetworkOptions()),
    "dueling": q_network((4,), 3, NetworkOptions(), (256,), dueling=True),
    "deep dueling": q_network((1,), 2, NetworkOptions(hidden=(13,), activation="relu"), (5, 7), dueling=True),
    "no body": q_network((5,), 3, NetworkOptions(hidden=()), dueling=True),
    "actor critic": actor_critic((3,), 3, NetworkOptions(hidden=(33,), activation="relu", initialisation="pytorch")),
    "twins": twin_q((20,), 6, NetworkOptions(hidden=(65, 16), activation="relu")),
}
IMAGES = NetworkOptions(hidden=(33,), convolutions=((16, 4, 2),), activation="relu", initialisation="pytorch")
NETWORKS |= {
    "convolution": q_network((4, 10, 10), 3, IMAGES),
    "convolutions": q_network(
        (3, 9, 7), 2, replace(IMAGES, convolutions=((5, 3, 2), (18, 2, 1), (4, 1, 1))), (6,), dueling=True
    ),
    "padded, channels last": q_network(
        (7, 8, 2), 2, replace(IMAGES, convolutions=((3, 3, 2), (7, 5, 1)), padding="same", layout="channels_last")
    ),
    "convolution alone": q_network((2, 4, 4), 3, replace(IMAGES, hidden=())),
    "twins of convolutions": twin_q((2, 5, 5), 2, replace(IMAGES, convolutions=((3, 3, 1), (4, 2, 1)))),
    "actor critic of a convolution": actor_critic((2, 5, 5), 2, IMAGES),
    "normalised": q_network((4,), 2, NetworkOptions(hidden=(33, 16), layer_norm=True), (5,), dueling=True),
    "normalised twins": twin_q((4,), 2, NetworkOptions(hidden=(65, 16), activation="relu", layer_norm=True)),
    "normalised convolution": q_network((4, 10, 10), 3, replace(IMAGES, layer_norm=True)),
}
each_network = pytest.mark.parametrize("network", NETWORKS.values(), ids=NETWORKS)


def normal(*shape: int, seed: int = 1) -> Values:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def inputs_of(network: Architecture) -> int:
    return int(np.prod(network.shape))


def both(network: Architecture, descent: Descent, size: int) -> tuple[CompiledNetwork, StackedNetwork]:
    seeds = [5, 6, 7]
    return (
        CompiledNetwork(network, seeds, descent, size, has_other=True),
        StackedNetwork(network, seeds, descent, "cpu", 8, has_other=True),
    )


@each_network
@pytest.mark.parametrize("size", [1, 9, 32])
def test_gradients_are_those_of_autograd(network: Architecture, size: int) -> None:
    """Of Σ d · outputs in every parameter, in double precision; what rows are filled up with has none."""
    compiled, stacked = both(network, Descent(1e-3, 1e-8), size)
    x, slope = normal(1, size, inputs_of(network)), normal(1, size, network.num_outputs, seed=2)
    outputs = np.zeros_like(slope)
    rows = torch.from_numpy(compiled.arrays.online[1:2].astype(np.float64)).requires_grad_()
    expected = stacked.values(rows, torch.from_numpy(x.astype(np.float64)))
    (gradient,) = torch.autograd.grad((expected * torch.from_numpy(slope)).sum(), rows)
    compiled.arrays.predict(runs_of(1), size, x, outputs)
    np.testing.assert_allclose(outputs, expected.detach().numpy(), atol=2e-6)
    compiled.arrays.descend(runs_of(1), size, x, slope)
    scale = float(gradient.abs().max())
    np.testing.assert_allclose(compiled.arrays.gradient[None], gradient.numpy(), atol=2e-6 * scale)


@each_network
@pytest.mark.parametrize(
    "descent", [Descent(1e-2, 1e-8), Descent(1e-2, 1e-3, 0.5, by_variable=True), Descent(1e-2, 1e-8, 0.5)]
)
def test_steps_are_those_of_pytorch(network: Architecture, descent: Descent) -> None:
    """Forty steps of two of three runs, clipped or not: parameters, moments, and averages on the way."""
    compiled, stacked = both(network, descent, 8)
    outputs = np.zeros((1, 8, network.num_outputs), dtype=np.float32)
    for step in range(20):
        x = normal(1, 8, inputs_of(network), seed=step)
        for run in (0, 2):
            for one in (compiled.arrays, stacked):
                one.predict(runs_of(run), 8, x, outputs)
                one.descend(runs_of(run), 8, x, np.tanh(outputs) + np.float32(0.5))
                one.follow(runs_of(run), 1.0 if step == 5 else 0.1)
    for found, expected in zip((compiled.state(), stacked.state()), (stacked.state(), compiled.state()), strict=True):
        for name in ("online", "other"):
            np.testing.assert_allclose(found[name], expected[name], atol=2e-4)
    assert compiled.arrays.clock.tolist() == [20, 0, 20]
    np.testing.assert_array_equal(compiled.arrays.online[1], compiled.layout.initial_rows([5, 6, 7])[1])


@each_network
def test_runs_are_computed_alone(network: Architecture) -> None:
    """Whoever else is named in a call, whatever the size of the batch, and wherever the rows lie: the same bits."""
    compiled, _ = both(network, Descent(1e-3, 1e-8), 40)
    x = normal(3, 40, inputs_of(network))
    together = np.zeros((3, 40, network.num_outputs), dtype=np.float32)
    compiled.arrays.evaluate(ONLINE, runs_of(0, 1, 2), 40, x, together)
    for run in range(3):
        other = CompiledNetwork(network, [5 + run], Descent(1e-3, 1e-8), 1, has_other=True)
        for j in (0, 1, 7, 39):
            one = np.zeros((1, 1, network.num_outputs), dtype=np.float32)
            other.arrays.evaluate(OTHER, runs_of(0), 1, x[run, j][None, None], one)
            np.testing.assert_array_equal(one[0, 0], together[run, j])


def test_adam_by_hand() -> None:
    """The first step is lr · g / (|g| + ε), whatever g's size: the corrected moments are g and g²."""
    network = CompiledNetwork(NETWORKS["no body"], [1], Descent(0.5, 1e-4), 1, has_other=False)
    arrays: Any = network.arrays
    before = arrays.online.copy()
    from apel.learners.deep.passes import adam

    gradient = np.zeros(network.layout.size, dtype=np.float32)
    gradient[:3] = [4.0, -0.001, 1e-4]
    adam(1, 0.5, 1e-4, gradient, arrays.online[0], arrays.mean[0], arrays.square[0])
    moved = (before - arrays.online)[0, :4]
    # 0.5 · 0.001 / 0.0011 and 0.5 · 1e-4 / 2e-4.
    assert moved.tolist() == pytest.approx([0.4999875, -0.4545454, 0.25, 0.0], rel=1e-4)
