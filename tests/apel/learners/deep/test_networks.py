"""Networks on both engines against PyTorch's modules, initial weights, and where variables lie in a row."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from apel.learners.deep.initialisers import fan_in_uniform, glorot, orthogonal, zeros
from apel.learners.deep.networks import Architecture, NetworkOptions, actor_critic, q_network, twin_q
from apel.learners.deep.parameters import Layout
from tests.apel.learners.deep.tables import Values, compiled, rows_of, stacked

NO_BODY = NetworkOptions(hidden=())
RELU = NetworkOptions(hidden=(8,), activation="relu")
ENGINES: dict[str, Callable[[Architecture, Values, Values], Values]] = {"compiled": compiled, "stacked": stacked}
each_engine = pytest.mark.parametrize("engine", ENGINES)


def normal(*shape: int, seed: int = 1) -> Values:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def variables_of(modules: list[Any]) -> list[Any]:
    """Weights and biases of modules, in their order."""
    found = []
    for module in modules:
        weight = module.weight.detach().numpy()
        found += [weight.T if isinstance(module, nn.Linear) else weight, module.bias.detach().numpy()]
    return found


def assert_is(engine: str, architecture: Architecture, modules: list[Any], plain: Callable[[Any], Any]) -> None:
    """Of two runs with the same weights."""
    x = normal(2, 7, *architecture.shape)
    rows = rows_of(architecture, variables_of(modules), variables_of(modules))
    found = ENGINES[engine](architecture, rows, x)
    expected = [plain(torch.from_numpy(one)).detach().numpy() for one in x]
    np.testing.assert_allclose(found, expected, atol=1e-5)


@each_engine
def test_body_and_head(engine: str) -> None:
    """Dense layers with the activation of the options over flattened images; one output per action."""
    architecture = q_network((2, 3), 4, NetworkOptions(hidden=(6, 35)))
    first, second, head = modules = [nn.Linear(6, 6), nn.Linear(6, 35), nn.Linear(35, 4)]
    assert_is(engine, architecture, modules, lambda x: head(torch.tanh(second(torch.tanh(first(x.flatten(1)))))))


@each_engine
def test_dueling_heads(engine: str) -> None:
    """Hidden layers of a head have ReLU, its last one nothing; both heads see the same features: V + A − mean A."""
    architecture = q_network((3,), 4, NetworkOptions(hidden=(8,)), (6,), dueling=True)
    body, *heads = modules = [nn.Linear(*size) for size in [(3, 8), (8, 6), (6, 4), (8, 6), (6, 1)]]

    def plain(x: Any) -> Any:
        advantage, value = (heads[i + 1](torch.relu(heads[i](torch.tanh(body(x))))) for i in (0, 2))
        return value + advantage - advantage.mean(1, keepdim=True)

    assert_is(engine, architecture, modules, plain)


@each_engine
def test_dueling_by_hand(engine: str) -> None:
    """Q = V + A − mean A: V = 10 and A = (1, 2, 6) give (8, 9, 13)."""
    architecture = q_network((1,), 3, NO_BODY, dueling=True)
    rows = rows_of(architecture, [[[1.0, 2.0, 6.0]], np.zeros(3), [[10.0]], np.zeros(1)])
    assert ENGINES[engine](architecture, rows, np.ones((1, 1, 1), np.float32)).tolist() == [[[8.0, 9.0, 13.0]]]


@each_engine
def test_actor_and_critic_share_a_body(engine: str) -> None:
    """Logits first, then Q, both linear in the same features."""
    body, heads = modules = [nn.Linear(3, 8), nn.Linear(8, 8)]
    assert_is(engine, actor_critic((3,), 4, RELU), modules, lambda x: heads(torch.relu(body(x))))


@each_engine
def test_twins_share_nothing(engine: str) -> None:
    """Two whole networks, which differ from the beginning."""
    architecture = twin_q((3,), 4, RELU)
    modules = [nn.Linear(3, 8), nn.Linear(8, 4), nn.Linear(3, 8), nn.Linear(8, 4)]
    twins = [lambda x, i=i: modules[i + 1](torch.relu(modules[i](x))) for i in (0, 2)]
    assert_is(engine, architecture, modules, lambda x: torch.cat([twin(x) for twin in twins], 1))
    fresh = ENGINES[engine](architecture, Layout(architecture).initial_rows([1]), normal(1, 9, 3))
    assert (fresh[..., :4] != fresh[..., 4:]).all()


@each_engine
def test_convolutions_are_those_of_pytorch(engine: str) -> None:
    """Convolutions with ReLU, then dense layers over flattened images."""
    options = NetworkOptions(hidden=(6,), convolutions=((3, 3, 1), (2, 2, 2)))
    # 10 → 8 → 4: 2 · 4 · 4 features.
    modules: list[Any] = [nn.Conv2d(4, 3, 3), nn.Conv2d(3, 2, 2, 2), nn.Linear(32, 6), nn.Linear(6, 3)]
    first, second, *dense = modules
    images = [first, nn.ReLU(), second, nn.ReLU(), nn.Flatten()]
    plain = nn.Sequential(*images, dense[0], nn.Tanh(), dense[1])
    assert_is(engine, q_network((4, 10, 10), 3, options), modules, plain)


@each_engine
def test_hidden_layers_are_normalised(engine: str) -> None:
    """Before their activation, those of a head too, and no output."""
    architecture = q_network((3,), 4, NetworkOptions(hidden=(8, 17), layer_norm=True), (5,))
    first, second, hidden, head = modules = [nn.Linear(*size) for size in [(3, 8), (8, 17), (17, 5), (5, 4)]]

    def normal_form(x: Any) -> Any:
        return nn.functional.layer_norm(x, x.shape[-1:])

    def plain(x: Any) -> Any:
        x = torch.tanh(normal_form(first(x)))
        x = torch.tanh(normal_form(second(x)))
        return head(torch.relu(normal_form(hidden(x))))

    assert_is(engine, architecture, modules, plain)


@each_engine
def test_normalised_by_hand(engine: str) -> None:
    """(1, 2, 6) has the mean 3 and the variance (4 + 1 + 9) / 3; behind ReLU 3 / √(14 / 3) remains."""
    options = NetworkOptions(hidden=(3,), activation="relu", layer_norm=True)
    rows = rows_of(q_network((1,), 3, options), [[[1.0, 2.0, 6.0]], np.zeros(3), np.eye(3), np.zeros(3)])
    found = ENGINES[engine](q_network((1,), 3, options), rows, np.ones((1, 1, 1), np.float32))
    np.testing.assert_allclose(found, [[[0.0, 0.0, 3 / math.sqrt(14 / 3)]]], atol=1e-5)


def conv(kernel: int, stride: int, size: int, padding: Any = "same") -> Architecture:
    options = NetworkOptions(hidden=(), convolutions=((1, kernel, stride),), padding=padding)
    return q_network((1, size, size), 1, options)


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
@each_engine
def test_sizes_of_same_padding_are_those_of_tensorflow(
    engine: str, size: int, kernel: int, stride: int, expected: int
) -> None:
    """As many outputs as inputs divided by the stride, rounded up."""
    architecture = conv(kernel, stride, size)
    assert architecture.layers[0].result == (1, expected, expected)  # type: ignore[union-attr]
    rows = Layout(architecture).initial_rows([1])
    assert ENGINES[engine](architecture, rows, normal(1, 2, 1, size, size)).shape == (1, 2, 1)


@each_engine
def test_same_padding_is_asymmetric(engine: str) -> None:
    """Of an odd margin the larger half comes after the image, as in TensorFlow.

    The numbers 1 … 16 in a square, a 3 × 3 filter of ones with stride 2: 2 · 1 + 3 − 4 = 1 row of zeros, below. The
    sums are those of rows and columns 0–2 and 2–3: 54, 45; 72, 54. With the margin before them the first would be 14.
    """
    architecture = conv(3, 2, 4)
    image = np.arange(1.0, 17.0, dtype=np.float32).reshape(1, 1, 1, 4, 4)
    for place, expected in enumerate([54.0, 45.0, 72.0, 54.0]):
        head = np.zeros((4, 1))
        head[place] = 1.0
        rows = rows_of(architecture, [np.ones((1, 1, 3, 3)), [0.0], head, [0.0]])
        assert ENGINES[engine](architecture, rows, image).item() == expected


@each_engine
def test_channels_that_come_last_are_turned_round(engine: str) -> None:
    """The same image gives the same values in both layouts, whose options alone differ."""
    plain = NetworkOptions(hidden=(6,), convolutions=((3, 3, 1),), padding="same")
    first = q_network((3, 10, 8), 4, plain)
    last = q_network((10, 8, 3), 4, replace(plain, layout="channels_last"))
    rows, x = Layout(first).initial_rows([1, 2]), normal(2, 7, 3, 10, 8)
    values = ENGINES[engine]
    np.testing.assert_array_equal(values(last, rows, np.moveaxis(x, 2, -1)), values(first, rows, x))


@pytest.mark.parametrize(
    ("shape", "layout", "is_refused"),
    [
        ((10, 8, 3), None, True),
        ((84, 84, 1), None, True),
        ((10, 8, 3), "channels_first", False),
        ((10, 8, 3), "channels_last", False),
        ((3, 10, 8), None, False),
        ((4, 4, 4), None, False),
        ((16, 10, 10), None, False),
    ],
)
def test_images_that_do_not_look_like_channels_first_are_refused(
    shape: tuple[int, ...], layout: Any, is_refused: bool
) -> None:
    """Rows would be taken for channels without a word; whoever says which layout it is, is believed."""
    options = NetworkOptions(convolutions=((2, 3, 1),), padding="same", layout=layout)
    if is_refused:
        with pytest.raises(ValueError, match=r"channels seem to come last, .* layout: channels_last"):
            q_network(shape, 2, options)
    else:
        q_network(shape, 2, options)


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
        q_network(shape, 2, NetworkOptions(convolutions=convolutions))


def test_networks_that_fill_the_memory_are_refused() -> None:
    """Each run has some copies of all parameters."""
    with pytest.raises(ValueError, match=r"found 16,\d+,\d+ parameters, expected at most 10,000,000"):
        Layout(q_network((4,), 2, NetworkOptions(hidden=(4000, 4000))))


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


# Initial weights.


def first_variables(options: NetworkOptions, inputs: int = 30) -> tuple[Values, Values]:
    layout = Layout(q_network((inputs,), 2, options))
    weight, bias = layout.unpack(layout.initial_rows([3]))[:2]
    return weight[0], bias[0]


@pytest.mark.parametrize(("inputs", "units"), [(30, 20), (20, 30)])
def test_orthogonal_weights(inputs: int, units: int) -> None:
    """The shorter side's vectors are orthogonal with length √2, biases are zero (OpenAI Baselines' ``mlp``)."""
    weight, bias = first_variables(NetworkOptions(hidden=(units,)), inputs)
    shorter = weight if inputs < units else weight.T
    np.testing.assert_allclose(shorter @ shorter.T, 2.0 * np.eye(20), atol=1e-5)
    assert (bias == 0.0).all()


def test_pytorch_weights() -> None:
    """Uniform on ±1 / √inputs, biases too: mean 0 and variance 1 / (3 inputs)."""
    weight, bias = first_variables(NetworkOptions(hidden=(400,), initialisation="pytorch"))
    bound = 30**-0.5
    assert np.abs(weight).max() <= bound
    assert 0.8 * bound < np.abs(bias).max() <= bound
    assert weight.var() == pytest.approx(1 / 90, rel=0.05)
    assert abs(weight.mean()) < 0.005


def test_heads_are_initialised_as_baselines_initialises_them() -> None:
    """Beside orthogonal bodies, Q-heads are Glorot-uniform, ±√(6 / (inputs + outputs)), with zero biases."""
    layout = Layout(q_network((4,), 50, NetworkOptions(hidden=(70,))))
    weight, bias = layout.unpack(layout.initial_rows([1]))[2:]
    bound = math.sqrt(6 / 120)
    assert 0.98 * bound < np.abs(weight).max() <= bound
    assert weight.var() == pytest.approx(bound**2 / 3, rel=0.1)
    assert (bias == 0.0).all()


@pytest.mark.parametrize(("initialise", "bound"), [(glorot, math.sqrt(6 / 60)), (fan_in_uniform(40), 40**-0.5)])
def test_bounds_of_initialisers(initialise: Any, bound: float) -> None:
    """Glorot's is that of inputs and outputs together, PyTorch's that of the inputs."""
    generator = np.random.default_rng(1)
    assert 0.95 * bound < np.abs(initialise((20, 40), generator)).max() <= bound
    assert (zeros((20, 40), generator) == 0.0).all()
    weight = orthogonal(3.0)((20, 5, 8), generator).reshape(20, 40)
    np.testing.assert_allclose(weight @ weight.T, 9.0 * np.eye(20), atol=1e-4)


def test_two_heads_side_by_side_are_two_heads() -> None:
    """Each half of them is orthogonal by itself."""
    layout = Layout(actor_critic((3,), 4, NetworkOptions(hidden=(20,))))
    heads = layout.unpack(layout.initial_rows([1]))[2][0]
    for half in (heads[:, :4], heads[:, 4:]):
        np.testing.assert_allclose(half.T @ half, 2.0 * np.eye(4), atol=1e-5)


# Rows.

NETWORKS = {
    "q": q_network((5,), 3, NetworkOptions(hidden=(7, 33)), (10,), dueling=True),
    "convolutions": q_network((4, 10, 10), 3, NetworkOptions(convolutions=((3, 3, 1),))),
    "actor": actor_critic((1,), 1, NetworkOptions(hidden=(1,))),
    "twins": twin_q((5,), 6, NetworkOptions(hidden=(17,))),
}
each_network = pytest.mark.parametrize("network", NETWORKS.values(), ids=NETWORKS)


@each_network
def test_variables_do_not_overlap(network: Architecture) -> None:
    """What is written into one variable of one run is read from there alone; variables are views of the rows."""
    layout = Layout(network)
    rows = np.zeros((3, layout.size), dtype=np.float32)
    variables = layout.unpack(rows)
    for i, variable in enumerate(variables):
        for run in range(3):
            variable[run] = 10 * i + run + 1
    for i, variable in enumerate(layout.unpack(torch.from_numpy(rows))):
        for run in range(3):
            assert (variable[run] == 10 * i + run + 1).all()
    assert np.count_nonzero(rows) == sum(variable.size for variable in variables)


@each_network
def test_every_variable_is_aligned(network: Architecture) -> None:
    """Each begins at a multiple of 64 bytes, in every row."""
    layout = Layout(network)
    rows = layout.initial_rows([1, 2, 3, 4, 5])
    assert layout.size % 16 == 0
    assert all(variable[run].ctypes.data % 64 == 0 for variable in layout.unpack(rows) for run in range(5))


@each_network
def test_initial_row_depends_on_its_seed_alone(network: Architecture) -> None:
    """No other run matters, and what rows are filled up with is zero."""
    layout, seeds = Layout(network), [3, 2**64 - 1, 2**63, 0, 3 + 2**32]
    rows = layout.initial_rows(seeds)
    for i, seed in enumerate(seeds):
        np.testing.assert_array_equal(layout.initial_rows([7, seed])[1], rows[i])
    filled = np.zeros_like(rows)
    for variable in layout.unpack(filled):
        variable[...] = 1.0
    assert (rows[filled == 0.0] == 0.0).all()


def test_seeds_that_differ_give_other_weights() -> None:
    """All 64 bits of a seed count."""
    rows = Layout(NETWORKS["q"]).initial_rows([0, 1, 2, 5, 5 + 2**32, 5 + 2**63])
    assert len({tuple(row.tolist()) for row in rows}) == 6


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(*[st.integers(1, 40)] * 2), min_size=1, max_size=3), st.sampled_from([compiled, stacked]))
def test_tables_hold_what_is_put_into_them(shapes: list[tuple[int, int]], engine: Any) -> None:
    """Without a body, row s of the weights is Q(s, ·)."""
    for num_states, num_actions in shapes:
        network = q_network((num_states,), num_actions, NO_BODY)
        table = normal(num_states, num_actions)
        rows = rows_of(network, [table, np.zeros(num_actions)])
        np.testing.assert_array_equal(engine(network, rows, np.eye(num_states, dtype=np.float32)[None])[0], table)
