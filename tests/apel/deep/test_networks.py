"""Layers and networks against PyTorch's own, initial weights, and where variables lie in a row of parameters."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from apel.learners.deep.layers import Convolution, Linear, fan_in_uniform, glorot, orthogonal, zeros
from apel.learners.deep.networks import ActorCritic, Layout, NetworkOptions, QNetwork, TwinQ, make_body
from apel.learners.deep.parameters import initial_rows
from tests.apel.deep.tables import NO_BODY, q_table_network, rows_of

CPU = torch.device("cpu")


def normal(*shape: int, seed: int = 1) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def row_of(layout: Layout, modules: list[nn.Linear | nn.Conv2d]) -> Tensor:
    """The row that holds the weights of these modules, in their order."""
    row = torch.zeros(1, sum(layout.sizes))
    variables = layout.unpack(row)
    for i, module in enumerate(modules):
        weight = module.weight.detach()
        variables[2 * i][0] = weight.t() if isinstance(module, nn.Linear) else weight
        variables[2 * i + 1][0] = module.bias.detach()
    return row[0]


# Layers.


@pytest.mark.parametrize("outputs", [1, 2, 5, 64])
def test_linear_is_that_of_pytorch(outputs: int) -> None:
    """``x W + b`` for each run with its own W and b, a single output included."""
    modules = [nn.Linear(7, outputs) for _ in range(3)]
    layer = Linear(7, outputs, glorot)
    layout = Layout(layer.variables)
    rows = torch.stack([row_of(layout, [module]) for module in modules])
    x = normal(3, 6, 7)
    found = layer(iter(layout.unpack(rows)), x)
    expected = torch.stack([module(one) for module, one in zip(modules, x, strict=True)])
    torch.testing.assert_close(found, expected.detach())


@pytest.mark.parametrize(
    ("kernel", "stride", "size"), [(3, 1, (10, 10)), (8, 4, (20, 24)), (2, 3, (9, 5)), (1, 1, (4, 4))]
)
def test_convolution_is_that_of_pytorch(kernel: int, stride: int, size: tuple[int, int]) -> None:
    """``valid`` padding is none: each run's images with its own filters."""
    modules = [nn.Conv2d(3, 5, kernel, stride) for _ in range(2)]
    layer = Convolution(3, 5, kernel, stride, "valid", glorot)
    layout = Layout(layer.variables)
    rows = torch.stack([row_of(layout, [module]) for module in modules])
    x = normal(2, 4, 3, *size)
    found = layer(iter(layout.unpack(rows)), x)
    expected = torch.stack([module(one) for module, one in zip(modules, x, strict=True)])
    torch.testing.assert_close(found, expected.detach())
    assert found.shape[-2:] == (layer.output_size(size[0]), layer.output_size(size[1]))


@pytest.mark.parametrize(
    ("size", "kernel", "stride", "expected"),
    [
        # Baselines' conv_only on 84 × 84 has 7744 = 64 · 11 · 11 features; MinAtar's 10 × 10 keep their size.
        (84, 8, 4, 21),
        (21, 4, 2, 11),
        (11, 3, 1, 11),
        (10, 3, 1, 10),
        (5, 1, 2, 3),
        (2, 5, 1, 2),
        # A stride beyond the kernel needs no padding: ⌈9 / 4⌉ = 3 windows of 1.
        (9, 1, 4, 3),
    ],
)
def test_sizes_of_same_padding_are_those_of_tensorflow(size: int, kernel: int, stride: int, expected: int) -> None:
    """As many outputs as inputs divided by the stride, rounded up."""
    layer = Convolution(1, 1, kernel, stride, "same", glorot)
    layout = Layout(layer.variables)
    found = layer(iter(layout.unpack(torch.zeros(1, sum(layout.sizes)))), torch.zeros(1, 1, 1, size, size))
    assert layer.output_size(size) == expected
    assert found.shape == (1, 1, 1, expected, expected)


def test_same_padding_is_asymmetric() -> None:
    """Of an odd margin the larger half comes after the image, as in TensorFlow.

    The numbers 1 … 16 in a square, a 3 × 3 filter of ones with stride 2: 2 · 1 + 3 − 4 = 1 row of zeros, below. The
    sums are those of rows and columns 0–2 and 2–3: 54, 45; 72, 54. With the margin before them the first would be 14.
    """
    layer = Convolution(1, 1, 3, 2, "same", lambda weight, generator: weight.fill_(1.0))
    layout = Layout(layer.variables)
    row = layout.initial_row(torch.Generator())
    image = torch.arange(1.0, 17.0).reshape(1, 1, 1, 4, 4)
    assert layer(iter(layout.unpack(row[None])), image).tolist() == [[[[[54.0, 45.0], [72.0, 54.0]]]]]


# Initial weights.


def first_variables(options: NetworkOptions, inputs: int = 30) -> tuple[Tensor, Tensor]:
    body, _ = make_body((inputs,), options)
    layout = Layout(body.variables)
    weight, bias = layout.unpack(layout.initial_row(torch.Generator().manual_seed(3))[None])[:2]
    return weight[0], bias[0]


@pytest.mark.parametrize(("inputs", "units"), [(30, 20), (20, 30)])
def test_orthogonal_weights(inputs: int, units: int) -> None:
    """The shorter side's vectors are orthogonal with length √2, biases are zero (OpenAI Baselines' ``mlp``)."""
    weight, bias = first_variables(NetworkOptions(hidden=(units,)), inputs)
    shorter = weight if inputs < units else weight.t()
    torch.testing.assert_close(shorter @ shorter.t(), 2.0 * torch.eye(20), atol=1e-5, rtol=0.0)
    assert (bias == 0.0).all()


def test_pytorch_weights() -> None:
    """Uniform on ±1 / √inputs, biases too: mean 0 and variance 1 / (3 inputs)."""
    weight, bias = first_variables(NetworkOptions(hidden=(400,), initialisation="pytorch"))
    bound = 30**-0.5
    assert float(weight.abs().max()) <= bound
    assert 0.8 * bound < float(bias.abs().max()) <= bound
    assert float(weight.var()) == pytest.approx(1 / 90, rel=0.05)
    assert abs(float(weight.mean())) < 0.005


def test_heads_are_initialised_as_baselines_initialises_them() -> None:
    """Beside orthogonal bodies, Q-heads are Glorot-uniform, ±√(6 / (inputs + outputs)), with zero biases."""
    network = QNetwork((4,), 50, NetworkOptions(hidden=(70,)), (), dueling=False)
    _, _, weight, bias = network.layout.unpack(network.layout.initial_row(torch.Generator().manual_seed(1))[None])
    bound = math.sqrt(6 / 120)
    assert 0.98 * bound < float(weight.abs().max()) <= bound
    assert float(weight.var()) == pytest.approx(bound**2 / 3, rel=0.1)
    assert (bias == 0.0).all()


@pytest.mark.parametrize(("initialise", "bound"), [(glorot, math.sqrt(6 / 60)), (fan_in_uniform(40), 40**-0.5)])
def test_bounds_of_initialisers(initialise: Any, bound: float) -> None:
    """Glorot's is that of inputs and outputs together, PyTorch's that of the inputs."""
    weight = torch.zeros(20, 40)
    initialise(weight, torch.Generator().manual_seed(1))
    assert 0.95 * bound < float(weight.abs().max()) <= bound
    zeros(weight, torch.Generator())
    assert (weight == 0.0).all()
    orthogonal(3.0)(weight, torch.Generator().manual_seed(1))
    torch.testing.assert_close(weight @ weight.t(), 9.0 * torch.eye(20), atol=1e-4, rtol=0.0)


# Networks.


def test_body_is_that_of_pytorch() -> None:
    """Convolutions with ReLU, then dense layers with the activation of the options, over flattened images."""
    options = NetworkOptions(hidden=(6, 5), convolutions=((3, 3, 1), (2, 2, 2)), activation="tanh")
    network = QNetwork((4, 10, 10), 3, options, (), dueling=False)
    # 10 → 8 → 4: 2 · 4 · 4 features.
    modules: list[Any] = [nn.Conv2d(4, 3, 3), nn.Conv2d(3, 2, 2, 2), nn.Linear(32, 6), nn.Linear(6, 5), nn.Linear(5, 3)]
    first, second, *dense = modules
    images = [first, nn.ReLU(), second, nn.ReLU(), nn.Flatten()]
    plain = nn.Sequential(*images, dense[0], nn.Tanh(), dense[1], nn.Tanh(), dense[2])
    x = normal(1, 7, 4, 10, 10)
    found = network(row_of(network.layout, modules)[None], x)
    torch.testing.assert_close(found[0], plain(x[0]).detach())


def test_images_without_convolutions_are_flattened() -> None:
    """A body of dense layers takes any shape."""
    network = QNetwork((2, 3), 4, NetworkOptions(hidden=(5,), activation="relu"), (), dueling=False)
    modules: list[Any] = [nn.Linear(6, 5), nn.Linear(5, 4)]
    x = normal(1, 3, 2, 3)
    found = network(row_of(network.layout, modules)[None], x)
    torch.testing.assert_close(found[0], modules[1](torch.relu(modules[0](x[0].flatten(1)))).detach())


def test_dueling_by_hand() -> None:
    """Q = V + A − mean A: V = 10 and A = (1, 2, 6) give (8, 9, 13)."""
    network = QNetwork((1,), 3, NO_BODY, (), dueling=True)
    row = torch.zeros(1, sum(network.layout.sizes))
    advantage, _, value, _ = network.layout.unpack(row)
    advantage[0], value[0] = torch.tensor([[1.0, 2.0, 6.0]]), torch.tensor([[10.0]])
    assert network(row, torch.ones(1, 1, 1)).tolist() == [[[8.0, 9.0, 13.0]]]


@given(st.floats(-100.0, 100.0))
def test_dueling_advantages_are_relative(constant: float) -> None:
    """Adding a constant to all advantages changes nothing; added to the value, it is added to Q."""
    network = QNetwork((3,), 4, NetworkOptions(hidden=(8,)), (6,), dueling=True)
    row = initial_rows(network.layout, [5], CPU)
    x = normal(1, 9, 3)
    before = network(row, x)
    # Body, two layers of the advantage's head, two of the value's: a weight and a bias each.
    variables = network.layout.unpack(row)
    assert [variable.shape[-1] for variable in variables[1::2]] == [8, 6, 4, 6, 1]
    variables[5] += constant
    torch.testing.assert_close(network(row, x), before, atol=1e-4, rtol=0.0)
    variables[9] += constant
    torch.testing.assert_close(network(row, x), before + constant, atol=1e-4, rtol=0.0)


def test_head_is_that_of_pytorch() -> None:
    """Hidden layers of a head have ReLU, its last one nothing; both heads see the same features."""
    network = QNetwork((3,), 4, NetworkOptions(hidden=(8,)), (6,), dueling=True)
    sizes = [(3, 8), (8, 6), (6, 4), (8, 6), (6, 1)]
    body, *heads = modules = [nn.Linear(*size) for size in sizes]
    x = normal(1, 9, 3)
    features = torch.tanh(body(x[0]))
    advantage, value = (heads[i + 1](torch.relu(heads[i](features))) for i in (0, 2))
    expected = value + advantage - advantage.mean(1, keepdim=True)
    torch.testing.assert_close(network(row_of(network.layout, modules)[None], x)[0], expected.detach())


def test_actor_and_critic_share_a_body() -> None:
    """Logits first, then Q, both linear in the same features."""
    network = ActorCritic((3,), 4, NetworkOptions(hidden=(8,), activation="relu"))
    body, policy, values = modules = [nn.Linear(3, 8), nn.Linear(8, 4), nn.Linear(8, 4)]
    x = normal(1, 9, 3)
    logits, q = network(row_of(network.layout, modules)[None], x)
    features = torch.relu(body(x[0]))
    torch.testing.assert_close(logits[0], policy(features).detach())
    torch.testing.assert_close(q[0], values(features).detach())


def test_twins_share_nothing() -> None:
    """Two whole networks, which differ from the beginning."""
    network = TwinQ((3,), 4, NetworkOptions(hidden=(8,), activation="relu", initialisation="pytorch"))
    modules = [nn.Linear(3, 8), nn.Linear(8, 4), nn.Linear(3, 8), nn.Linear(8, 4)]
    x = normal(2, 9, 3)
    row = row_of(network.layout, modules)
    found = network(torch.stack([row, row]), x)
    assert found.shape == (2, 2, 9, 4)
    for twin in range(2):
        for run in range(2):
            expected = modules[2 * twin + 1](torch.relu(modules[2 * twin](x[run])))
            torch.testing.assert_close(found[twin, run], expected.detach())
    fresh = network(initial_rows(network.layout, [1], CPU), x[:1])
    assert (fresh[0] != fresh[1]).all()


@pytest.mark.parametrize(
    ("shape", "convolutions", "message"),
    [
        ((4,), ((8, 3, 1),), r"found observations of shape \(4,\), expected \[channels, height, width\]"),
        ((1, 4, 4), ((8, 3, 1), (8, 3, 1)), "expected kernels that fit"),
    ],
)
def test_convolutions_have_to_fit(shape: tuple[int, ...], convolutions: Any, message: str) -> None:
    """Vectors have no height, and a kernel is not larger than what it sees; the error says so."""
    with pytest.raises(ValueError, match=message):
        make_body(shape, NetworkOptions(convolutions=convolutions))


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("hidden", (0,)),
        ("hidden", (2.5,)),
        ("convolutions", ((8, 3),)),
        ("convolutions", ((8, 0, 1),)),
        ("padding", "reflect"),
        ("activation", "gelu"),
        ("initialisation", "zero"),
        ("depth", 3),
    ],
)
def test_options_out_of_range_are_refused(option: str, value: Any) -> None:
    """Widths, kernels and strides are at least 1, names are known, and nothing unknown is taken."""
    with pytest.raises(ValueError, match=option):
        NetworkOptions(**{option: value})


# Rows.

LAYOUTS = {
    "q": QNetwork((5,), 3, NetworkOptions(hidden=(7, 33)), (10,), dueling=True).layout,
    "convolutions": QNetwork((4, 10, 10), 3, NetworkOptions(convolutions=((3, 3, 1),)), (), dueling=False).layout,
    "actor": ActorCritic((1,), 1, NetworkOptions(hidden=(1,))).layout,
    "twins": TwinQ((5,), 6, NetworkOptions(hidden=(17,))).layout,
}


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_variables_do_not_overlap(layout: Layout) -> None:
    """What is written into one variable of one run is read from there alone; variables are views of the rows."""
    rows = torch.zeros(3, sum(layout.sizes))
    variables = layout.unpack(rows)
    for i, variable in enumerate(variables):
        for run in range(3):
            variable[run] = 10 * i + run + 1
    for i, variable in enumerate(layout.unpack(rows)):
        for run in range(3):
            assert (variable[run] == 10 * i + run + 1).all()
    assert int((rows != 0.0).sum()) == sum(variable.numel() for variable in variables)


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_every_variable_is_aligned(layout: Layout) -> None:
    """Each begins at a multiple of 16 elements, 64 bytes, in every row, also of rows that were picked out."""
    assert all(size % 16 == 0 for size in layout.sizes)
    rows = initial_rows(layout, [1, 2, 3, 4, 5], CPU)
    for matrix in (rows, rows[torch.tensor([1, 2, 4])]):
        for variable in layout.unpack(matrix):
            assert all(variable[run].data_ptr() % 64 == 0 for run in range(len(matrix)))


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_initial_row_depends_on_its_seed_alone(layout: Layout) -> None:
    """Neither other runs nor the global generator matter; the padding is zero."""
    seeds = [3, 2**64 - 1, 2**63, 0]
    torch.manual_seed(1)
    rows = initial_rows(layout, seeds, CPU)
    torch.manual_seed(2)
    for i, seed in enumerate(seeds):
        assert torch.equal(initial_rows(layout, [7, seed], CPU)[1], rows[i])
    filled = torch.zeros_like(rows)
    for variable in layout.unpack(filled):
        variable.fill_(1.0)
    assert (rows[filled == 0.0] == 0.0).all()


@pytest.mark.parametrize(
    "seeds",
    [
        (0, 1, 2, 3),
        (5, 5 + 2**32, 5 + 2**63),
    ],
)
def test_seeds_that_differ_give_other_weights(seeds: tuple[int, ...]) -> None:
    """All 64 bits of a seed count."""
    rows = initial_rows(LAYOUTS["q"], seeds, CPU)
    assert len({tuple(row.tolist()) for row in rows}) == len(seeds)


@settings(max_examples=20)
@given(st.lists(st.tuples(*[st.integers(1, 40)] * 2), min_size=1, max_size=3))
def test_table_networks_hold_what_is_put_into_them(shapes: list[tuple[int, int]]) -> None:
    """The tests' own tables: row s of the table is Q(s, ·)."""
    for num_states, num_actions in shapes:
        network = q_table_network(num_states, num_actions)
        table = np.random.default_rng(num_states).normal(size=(num_states, num_actions))
        found = network(rows_of(network, [table]), torch.eye(num_states, dtype=torch.float64)[None])
        np.testing.assert_allclose(found[0].numpy(), table)
