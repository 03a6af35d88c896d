"""How PyTorch's networks are computed on a GPU, as far as a processor can tell."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from apel.learners.deep import stacked_network, stacked_rows
from apel.learners.deep.compiled_network import ACTING, Descent
from apel.learners.deep.networks import NetworkOptions, q_network
from apel.learners.deep.stacked_network import StackedNetwork
from tests.apel.learners.deep.steps import runs_of

IMAGES = q_network((3, 7, 6), 2, NetworkOptions(hidden=(16,), convolutions=((5, 3, 2), (4, 2, 1)), padding="same"))
BATCH = 4


@pytest.mark.parametrize(("size", "kernel", "stride"), [((7, 6), 3, 2), ((8, 8), 2, 2), ((5, 9), 3, 1), ((9, 9), 2, 3)])
def test_one_product_is_many_convolutions(size: tuple[int, int], kernel: int, stride: int) -> None:
    """Values, and the gradients of all that goes in, in double precision."""
    generator = torch.Generator().manual_seed(1)
    shapes = (3, 2, 4, *size), (3, 5, 4, kernel, kernel), (3, 5)
    given = [torch.randn(shape, generator=generator, dtype=torch.float64, requires_grad=True) for shape in shapes]
    forms = stacked_network._convolve_one_by_one, stacked_network._convolve_together
    expected, found = (form(*given, stride) for form in forms)
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


@pytest.mark.parametrize("lanes", [1, 3, 5, 8])
def test_lanes_are_filled_up(lanes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Calls of one shape give what calls of the chosen runs give."""
    expected, plain = learnt(lanes), stacked_rows.Rows.__init__

    def with_lanes(rows: stacked_rows.Rows, num_runs: int, device: torch.device, lanes: int) -> None:
        plain(rows, num_runs, device, lanes)
        rows._lanes = lanes

    monkeypatch.setattr(stacked_rows.Rows, "__init__", with_lanes)
    monkeypatch.setattr(stacked_network, "_convolve_one_by_one", stacked_network._convolve_together)
    found = learnt(lanes)
    assert found["step"].tolist() == [2, 3, 2, 0, 4]
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, atol=2e-5, err_msg=name)


def test_normalised_layers() -> None:
    """Mean 0 and variance 1 before the activation, for each input."""
    dense = q_network((6,), 2, NetworkOptions(hidden=(16,), activation="relu"))
    first = replace(dense.layers[0], activation="linear")
    network = StackedNetwork(
        replace(dense, layers=(replace(first, column=0),), num_outputs=16), [1], Descent(1e-3, 1e-8), "cpu", 1,
        has_other=False,
    )  # fmt: skip
    object.__setattr__(network.architecture.layers[0], "normalised", True)
    x = torch.from_numpy(np.random.default_rng(1).normal(size=(1, 9, 6)).astype(np.float32))
    found = network.values(network._online, x)
    torch.testing.assert_close(found.mean(-1), torch.zeros(1, 9), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(found.var(-1, correction=0), torch.ones(1, 9), atol=1e-3, rtol=0.0)
