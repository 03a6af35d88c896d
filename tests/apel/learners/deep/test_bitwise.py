"""What PyTorch makes of a run's row is the same, bit for bit, whatever rows stand beside it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from torch import Tensor

from apel.learners.deep.compiled_network import Descent
from apel.learners.deep.networks import Architecture, NetworkOptions, actor_critic, q_network, twin_q
from apel.learners.deep.stacked_network import StackedNetwork
from apel.learners.deep.stacked_rows import Rows, clip_each_row, clip_each_variable
from tests.apel.learners.deep.steps import runs_of

CPU = torch.device("cpu")
NUM_RUNS = 6

DENSE: dict[str, Callable[[int, int, int], Architecture]] = {
    "q": lambda inputs, actions, width: q_network(
        (inputs,), actions, NetworkOptions(hidden=(width,), activation="relu")
    ),
    "dueling": lambda inputs, actions, width: q_network(
        (inputs,), actions, NetworkOptions(hidden=(64, width)), (width,), dueling=True
    ),
    "actor critic": lambda inputs, actions, width: actor_critic(
        (inputs,), actions, NetworkOptions(hidden=(width,), activation="relu", initialisation="pytorch")
    ),
    "twins": lambda inputs, actions, width: twin_q(
        (inputs,), actions, NetworkOptions(hidden=(64, width), activation="relu", initialisation="pytorch")
    ),
}


def results(network: StackedNetwork, rows: Tensor, x: Tensor) -> list[Tensor]:
    """Values, gradients, and gradients clipped in both ways, ``[A, …]`` each."""
    moving = rows.detach().requires_grad_()
    outputs = network.values(moving, x)
    loss = (outputs.square() + outputs).flatten(1).mean(1).sum()
    (gradient,) = torch.autograd.grad(loss, moving)
    with torch.no_grad():
        clipped = [clip_each_variable(gradient.clone(), network.layout, 0.01), clip_each_row(gradient.clone(), 0.01)]
        acting = network.values(rows, x[:, :1].contiguous())
    return [outputs.detach(), gradient, *clipped, acting]


def from_numpy(values: NDArray[np.float32], start: int) -> Tensor:
    """The values in memory that begins ``start`` numbers behind a multiple of 64 bytes: NumPy's may begin anywhere."""
    room = np.zeros(values.size + 32, dtype=np.float32)
    first = (-room.ctypes.data // 4) % 16 + start
    placed = room[first : first + values.size].reshape(values.shape)
    placed[:] = values
    return torch.from_numpy(placed)


def check(architecture: Architecture, batch_size: int, subset: set[int], start: int = 4) -> None:
    """Each run alone, and the subset, against all."""
    network = StackedNetwork(architecture, range(NUM_RUNS), Descent(1e-3, 1e-8), "cpu", 8, has_other=False)
    matrix = torch.from_numpy(network.layout.initial_rows(range(NUM_RUNS)))
    shape = NUM_RUNS, batch_size, int(np.prod(architecture.shape))
    x = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    everything = results(network, matrix, from_numpy(x, 0))
    rows = Rows(NUM_RUNS, CPU, 8)
    for chosen in [[run] for run in range(NUM_RUNS)] + [sorted(subset)]:
        found = results(network, rows.of(matrix, runs_of(*chosen)), from_numpy(x[chosen], start))
        for one, all_of_them in zip(found, everything, strict=True):
            np.testing.assert_array_equal(
                one.numpy(), all_of_them.numpy()[chosen], err_msg=f"runs {chosen}", strict=True
            )


subsets = st.sets(st.integers(0, NUM_RUNS - 1), min_size=1)
few = settings(
    max_examples=6,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=[HealthCheck.too_slow],
    database=None,
)


@pytest.mark.parametrize("num_actions", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("kind", DENSE)
@few
@given(
    inputs=st.sampled_from([1, 2, 4, 20]),
    width=st.sampled_from([16, 64, 256]),
    batch_size=st.sampled_from([1, 32, 64, 4 * 21]),
    subset=subsets,
    start=st.integers(0, 15),
)
@example(inputs=4, width=256, batch_size=1, subset={1, 2, 4}, start=4)
@example(inputs=4, width=16, batch_size=32, subset={1, 5}, start=4)
@example(inputs=20, width=256, batch_size=1, subset={0, 3}, start=0)
def test_dense_networks(
    kind: str, num_actions: int, inputs: int, width: int, batch_size: int, subset: set[int], start: int
) -> None:
    """Values and gradients of each run, alone, in any subset, and in the whole stack."""
    check(DENSE[kind](inputs, num_actions, width), batch_size, subset, start)


@pytest.mark.parametrize("kind", DENSE)
@few
@given(
    num_actions=st.integers(1, 9),
    width=st.integers(1, 70),
    batch_size=st.integers(1, 40),
    subset=subsets,
)
@example(num_actions=5, width=33, batch_size=7, subset={1, 2, 4})
def test_dense_networks_of_any_size(kind: str, num_actions: int, width: int, batch_size: int, subset: set[int]) -> None:
    """Options allow any width and batch size, and environments any number of actions."""
    check(DENSE[kind](3, num_actions, width), batch_size, subset)


IMAGES: dict[str, Callable[[int], Architecture]] = {
    "valid": lambda actions: q_network(
        (4, 10, 10),
        actions,
        NetworkOptions(hidden=(128,), convolutions=((16, 3, 1),), activation="relu"),
        (64,),
        dueling=True,
    ),
    "same": lambda actions: actor_critic(
        (4, 10, 10), actions, NetworkOptions(hidden=(64,), convolutions=((8, 3, 2), (4, 2, 1)), padding="same")
    ),
}


@pytest.mark.parametrize("num_actions", [3, 6])
@pytest.mark.parametrize("kind", IMAGES)
@settings(few, max_examples=2)
@given(batch_size=st.sampled_from([1, 4 * 21]), subset=subsets)
@example(batch_size=32, subset={1, 2, 4})
def test_networks_over_images(kind: str, num_actions: int, batch_size: int, subset: set[int]) -> None:
    """The same with convolutions, over MinAtar's 10 × 10 × 4 (channels first)."""
    check(IMAGES[kind](num_actions), batch_size, subset)
