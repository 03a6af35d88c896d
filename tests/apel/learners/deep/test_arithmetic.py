"""Elementary functions and products against wider numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from apel.learners.deep import arithmetic
from apel.learners.deep.products import LANES, aligned, multiply, rectify, sum_of_squares, tile_of
from apel.numerics.compiled import njit


@njit
def exponentials(x: Any, out: Any) -> None:
    for i in range(x.shape[0]):
        out[i] = arithmetic.exp(x[i])


@njit
def logarithms(x: Any, out: Any) -> None:
    for i in range(x.shape[0]):
        out[i] = arithmetic.log(x[i])


@njit
def tangents(x: Any, out: Any) -> None:
    for i in range(x.shape[0]):
        out[i] = arithmetic.tanh32(x[i])


@njit
def powers(x: Any, out: Any) -> None:
    for i in range(x.shape[0]):
        out[i] = arithmetic.real_power(x[i], 0.6)


def values(function: Any, x: NDArray[Any]) -> NDArray[Any]:
    out = np.empty_like(x)
    function(x, out)
    return out


RNG = np.random.default_rng(1)
WIDE, NARROW = RNG.uniform(-700.0, 700.0, 50_000), RNG.uniform(-2.0, 2.0, 50_000)


@pytest.mark.parametrize(
    ("function", "exact", "x", "ulps"),
    [
        (exponentials, np.exp, WIDE, 1.0),
        (exponentials, np.exp, NARROW, 1.0),
        (logarithms, np.log, np.exp(WIDE), 1.0),
        (logarithms, np.log, np.exp2(NARROW), 1.0),
        (tangents, np.tanh, RNG.uniform(-12.0, 12.0, 50_000).astype(np.float32), 2.0),
        (tangents, np.tanh, RNG.normal(size=50_000).astype(np.float32) * np.float32(0.2), 2.0),
    ],
)
def test_functions_are_right_to_the_last_bit_or_two(
    function: Any, exact: Callable[[Any], Any], x: NDArray[Any], ulps: float
) -> None:
    """Against twice the precision, in units of the last place."""
    wider = exact(x.astype(np.longdouble))
    unit = np.spacing(np.abs(wider).astype(x.dtype)).astype(np.longdouble)
    assert (np.abs(values(function, x) - wider) / unit).max() <= ulps


def test_corners() -> None:
    """Beyond what can be told apart from 0, 1 and ∞, and of no number at all."""
    x = np.array([-1e9, -np.inf, 0.0, np.nan, 1e9])
    assert np.isnan(values(exponentials, x)[3])
    assert values(exponentials, x)[[0, 1]].max() < 1e-300
    assert values(exponentials, x)[2] == 1.0
    assert values(exponentials, x)[4] > 1e307
    x = np.array([-1e9, -np.inf, 0.0, np.nan, 1e9, 9.6], dtype=np.float32)
    np.testing.assert_array_equal(values(tangents, x), [-1.0, -1.0, 0.0, np.nan, 1.0, 1.0])
    assert values(logarithms, np.ones(1))[0] == 0.0


def test_powers() -> None:
    """By squaring, and of real exponents; 0 and 1 are exact."""
    assert [arithmetic.power(0.9, n) for n in (0, 1, 5)] == pytest.approx([1.0, 0.9, 0.59049])
    x = np.array([0.0, 1e-6, 0.3, 1.0, 80.0])
    np.testing.assert_allclose(values(powers, x), x**0.6, rtol=1e-13)
    assert arithmetic.real_power(3.7, 1.0) == 3.7
    assert arithmetic.real_power(0.0, 0.0) == 1.0


@settings(deadline=None)
@given(st.lists(st.floats(-50.0, 50.0, width=32), min_size=1, max_size=7))
def test_softmax_adds_up(logits: list[float]) -> None:
    """Probabilities of any logits, and the logarithm of the sum that they are over."""
    given, probability = np.array(logits, dtype=np.float32), np.empty(len(logits))
    total = arithmetic.softmax(given, probability)
    assert probability.sum() == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(probability, np.exp(given.astype(np.float64) - total), rtol=1e-13)


@settings(max_examples=60, deadline=None)
@given(
    rows=st.integers(1, 19),
    depth=st.integers(0, 9),
    columns=st.integers(1, 9),
    turned=st.booleans(),
    has_bias=st.booleans(),
)
def test_products(rows: int, depth: int, columns: int, turned: bool, has_bias: bool) -> None:
    """C + A B of any size, with A transposed or not, and with one row of C for all or one each."""
    width = 16 * columns
    a, b = RNG.normal(size=(rows, depth)).astype(np.float32), RNG.normal(size=(depth, width)).astype(np.float32)
    c = RNG.normal(size=(1 if has_bias else rows, width)).astype(np.float32)
    y = aligned(rows + 1, width)
    flat = np.ascontiguousarray(a.T if turned else a).reshape(-1)
    strides = (1, rows) if turned else (depth, 1)
    whole = c.reshape(-1), 0, 0 if has_bias else width
    multiply(rows, depth, width, flat, 0, *strides, b.reshape(-1), 0, width, *whole, y.reshape(-1), 0, width)
    expected = c.astype(np.float64) + a.astype(np.float64) @ b.astype(np.float64)
    np.testing.assert_allclose(y[:rows], np.broadcast_to(expected, (rows, width)), atol=1e-5)
    assert not y[rows].any()


def test_sums_go_step_by_step() -> None:
    """In the order of the depth, each product and sum rounded once: whichever tile an element is in.

    (1 + 2⁻¹²)² is 1 + 2⁻¹¹ + 2⁻²⁴, whose last bit a rounded product would lose; added to −1 it is kept.
    """
    number = np.float32(1.0 + 2.0**-12)
    for rows, width in ((1, 16), (8, 16), (4, 64), (13, 80)):
        a = np.tile(np.array([1.0, number, 1.0], dtype=np.float32), rows)
        b = np.concatenate([np.full(width, value, dtype=np.float32) for value in (-1.0, number, 2.0**-25)])
        y = np.empty(rows * width, dtype=np.float32)
        multiply(rows, 3, width, a, 0, 3, 1, b, 0, width, np.zeros_like(b), 0, 0, y, 0, width)
        exact = np.float32(np.float64(number) ** 2 - 1.0)
        assert (y == exact + np.float32(2.0**-25)).all()


@pytest.mark.parametrize("depth", [1, 5, 64])
def test_no_element_depends_on_its_tile(depth: int) -> None:
    """All together is row by row and vector by vector, bit for bit."""
    for rows, vectors in ((1, 4), (4, 1), (9, 1), (11, 4), (8, 5), (15, 11)):
        factors = matrices(rows, depth, vectors)
        together, alone = np.empty((2, rows * vectors * LANES), dtype=np.float32)
        multiply(rows, depth, vectors * LANES, *operands(factors), together, 0, vectors * LANES)
        one_by_one(factors, alone)
        assert together.tobytes() == alone.tobytes()


@pytest.mark.parametrize("shape", [(4, 4), (8, 1), (4, 1), (1, 4), (6, 2)])
def test_tiles_of_other_processors(shape: tuple[int, int]) -> None:
    """They are others where registers are, with the same elements, bit for bit."""
    tile = tile_of(*shape)

    @numba.njit
    def computed(depth: int, width: int, a: Any, b: Any, c: Any, y: Any) -> None:
        tile(a, 0, depth, 1, b, 0, width, depth, c, 0, width, y, 0, width)

    factors = matrices(shape[0], 7, shape[1])
    together, alone = np.empty((2, shape[0] * shape[1] * LANES), dtype=np.float32)
    computed(7, shape[1] * LANES, *(one.reshape(-1) for one in factors), together)
    one_by_one(factors, alone)
    assert together.tobytes() == alone.tobytes()


def matrices(rows: int, depth: int, vectors: int) -> list[NDArray[np.float32]]:
    width = vectors * LANES
    return [RNG.normal(size=shape).astype(np.float32) for shape in ((rows, depth), (depth, width), (rows, width))]


def operands(factors: list[NDArray[np.float32]], row: int = 0, column: int = 0) -> tuple[Any, ...]:
    """What `multiply` asks for of matrices, from one element of the product on."""
    (a, b, c), (depth, width) = factors, factors[1].shape
    flat = a.reshape(-1), b.reshape(-1), c.reshape(-1)
    return flat[0], row * depth, depth, 1, flat[1], column, width, flat[2], row * width + column, width


def one_by_one(factors: list[NDArray[np.float32]], product: NDArray[np.float32]) -> None:
    depth, width = factors[1].shape
    for row in range(len(factors[0])):
        for column in range(0, width, LANES):
            multiply(1, depth, LANES, *operands(factors, row, column), product, row * width + column, width)


def test_rectify() -> None:
    """Of part of an array; NaN stays, so that a network that diverged is not taken for one that is silent."""
    x = RNG.normal(size=96).astype(np.float32)
    x[16:22] = [np.nan, -np.nan, -0.0, np.inf, -np.inf, -1e-45]
    y = x.copy()
    rectified(y, 16, 80)
    expected = np.where(x[16:80] < 0, np.float32(0.0), x[16:80])
    np.testing.assert_array_equal(y[16:80], expected)
    assert not np.signbit(y[18])
    np.testing.assert_array_equal(y[:16], x[:16])
    np.testing.assert_array_equal(y[80:], x[80:])


@njit
def rectified(x: Any, begin: int, end: int) -> None:
    rectify(x, begin, end)


def test_sum_of_squares() -> None:
    """Of part of an array."""
    x = RNG.normal(size=160).astype(np.float32)
    assert sum_of_squares_of(x, 16, 144) == pytest.approx(float(np.square(x[16:144].astype(np.float64)).sum()))


@njit
def sum_of_squares_of(x: Any, begin: int, end: int) -> Any:
    return sum_of_squares(x, begin, end)
