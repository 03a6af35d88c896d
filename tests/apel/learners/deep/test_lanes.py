"""How PyTorch's networks are computed on a GPU, as far as a processor can tell."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from apel.learners.deep.compiled_network import ACTING, ONLINE, OTHER, Descent
from apel.learners.deep.initialisers import zeros
from apel.learners.deep.networks import Convolution, NetworkOptions, q_network
from apel.learners.deep.stacked_network import StackedNetwork, _convolve
from tests.apel.learners.deep.steps import runs_of

IMAGES = q_network((3, 7, 6), 2, NetworkOptions(hidden=(16,), convolutions=((5, 3, 2), (4, 2, 1)), padding="same"))
BATCH = 4


@pytest.mark.parametrize(("size", "kernel", "stride"), [((7, 6), 3, 2), ((8, 8), 2, 2), ((5, 9), 3, 1), ((9, 9), 2, 3)])
def test_one_product_is_many_convolutions(size: tuple[int, int], kernel: int, stride: int) -> None:
    """Values, and the gradients of all that goes in, in double precision."""
    generator = torch.Generator().manual_seed(1)
    shapes = (3, 2, 4, *size), (3, 5, 4, kernel, kernel), (3, 5)
    given = [torch.randn(shape, generator=generator, dtype=torch.float64, requires_grad=True) for shape in shapes]
    layer = Convolution(0, (4, *size), 5, kernel, stride, False, zeros)
    found = _convolve(layer, *given)
    each = zip(*given, strict=True)
    expected = torch.stack([torch.nn.functional.conv2d(one, w, b, stride=stride) for one, w, b in each])
    torch.testing.assert_close(found, expected)
    slope = torch.randn(expected.shape, generator=generator, dtype=torch.float64)
    gradients = [torch.autograd.grad(outputs, given, slope) for outputs in (expected, found)]
    for one, other in zip(*gradients, strict=True):
        torch.testing.assert_close(one, other)


def learnt(lanes: int) -> dict[str, Any]:
    """Some of five runs learn, one never, and one acts on what it was."""
    network = StackedNetwork(IMAGES, range(5), Descent(1e-2, 1e-5, 0.5, by_variable=True), "cpu", lanes, has_other=True)
    generator, found = np.random.default_rng(1), np.zeros((5, BATCH, 2), dtype=np.float32)
    for step, chosen in enumerate([(0, 1, 2, 4), (4,), (1, 4), (0, 1, 2, 4)]):
        x = generator.random((5, BATCH, 3 * 7 * 6), dtype=np.float32)
        for runs in network.calls(runs_of(*chosen)):
            network.predict(runs, BATCH, x[runs], found)
            network.descend(runs, BATCH, x[runs], np.tanh(found[: len(runs)]) + np.float32(0.5))
        network.follow(runs_of(*chosen), 1.0 if step % 2 else 0.1)
        if step == 1:
            network.freeze(runs_of(1))
    network.evaluate(ACTING, runs_of(0, 1, 2, 3, 4), 1, x, found)
    state = network.state()
    return {"found": found[:, :1], "online": state["online"], "other": state["other"], **state["adam"]}


@pytest.mark.parametrize(("one", "other"), [(OTHER, ONLINE), (OTHER, OTHER)])
def test_two_networks_on_the_same_inputs(one: int, other: int) -> None:
    """What each of them gives by itself, where more runs come than a call has lanes."""
    network = StackedNetwork(IMAGES, range(5), Descent(1e-2, 1e-5), "cpu", 2, has_other=True)
    runs, x = runs_of(0, 2, 4), np.random.default_rng(1).random((3, BATCH, 3 * 7 * 6), dtype=np.float32)
    found, expected = (np.zeros((2, 3, BATCH, 2), dtype=np.float32) for _ in range(2))
    for each in network.calls(runs):
        network.predict(each, BATCH, x, found[0])
        network.descend(each, BATCH, x, np.ones_like(found[0]))
    network.evaluate_both(one, other, runs, BATCH, x, *found)
    for which, outputs in zip((one, other), expected, strict=True):
        network.evaluate(which, runs, BATCH, x, outputs)
    np.testing.assert_array_equal(found, expected)
    assert (found[0] == found[1]).all() == (one == other)


@pytest.mark.parametrize("lanes", [1, 3, 8])
def test_lanes_are_filled_up(lanes: int) -> None:
    """Fewer lanes than runs, or more, give what as many give."""
    expected, found = learnt(5), learnt(lanes)
    assert found["step"].tolist() == [2, 3, 2, 0, 4]
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, atol=2e-5, err_msg=name)
