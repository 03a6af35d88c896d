"""Products of matrices in registers: what the compiled engine spends its time in.

A *tile* is some rows by some vectors of the product; its sums stay in registers while it goes along the depth, one
fused product and sum per element and step. So the order of every sum is the same on every machine, whatever the width
of its vectors: that is why this is written in LLVM's language, with vectors in it, and not left to a compiler that
would have to find them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from apel.numerics.compiled import njit

LANES = 16
"""Of a vector. Whatever has outputs is filled up to a multiple of it, so that no loop has a remainder."""
WIDE = 4
"""Vectors of a tile of one row, and of the strip of columns that is gone through at once."""
_BLOCK, _TALL = ((4, WIDE), 8) if get_host_cpu_features().get("avx512f") else ((4, 1), 4)
"""Rows and vectors of a tile in a strip, and rows of one in the columns that are left: as many sums as hide each
other's latency, and yet fit into the registers. Those of AVX-512 are twice as many as AVX2's, and twice as wide; NEON
has as many, a quarter as wide.
"""
_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_INDEX = ir.IntType(64)
_UNDEFINED = ir.Constant(_VECTOR, ir.Undefined)
_FIRST_LANE = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
Floats = NDArray[np.float32]


def _fma(builder: Any, *arguments: Any) -> Any:
    signature = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
    return builder.call(cgutils.get_or_insert_function(builder.module, signature, f"llvm.fma.v{LANES}f32"), arguments)


def _constant(number: int) -> ir.Constant:
    return ir.Constant(_INDEX, number)


def _vector_at(builder: Any, data: Any, place: Any) -> Any:
    return builder.bitcast(builder.gep(data, [place]), _VECTOR.as_pointer())


def _splat(builder: Any, number: Any) -> Any:
    one = builder.insert_element(_UNDEFINED, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, _UNDEFINED, _FIRST_LANE)


def _places(builder: Any, begin: Any, stride: Any, rows: int, vectors: int) -> list[Any]:
    starts = [builder.add(begin, builder.mul(stride, _constant(row))) for row in range(rows)]
    return [builder.add(start, _constant(LANES * vector)) for start in starts for vector in range(vectors)]


def _write_tile(context: Any, builder: Any, signature: Any, arguments: Any, rows: int, vectors: int) -> None:
    _, a_at, a_row, a_step, _, b_at, b_step, depth, _, c_at, c_row, _, y_at, y_row = arguments
    a_data, b_data, c_data, y_data = (
        context.make_array(signature.args[i])(context, builder, arguments[i]).data for i in (0, 4, 8, 11)
    )
    first = [
        builder.load(_vector_at(builder, c_data, place), align=4)
        for place in _places(builder, c_at, c_row, rows, vectors)
    ]
    before = builder.block
    loop, after = builder.append_basic_block("along"), builder.append_basic_block("after")
    builder.cbranch(builder.icmp_signed(">", depth, _constant(0)), loop, after)
    builder.position_at_end(loop)
    step, sums = builder.phi(_INDEX), [builder.phi(_VECTOR) for _ in first]
    b_place = builder.add(b_at, builder.mul(step, b_step))
    right = [
        builder.load(_vector_at(builder, b_data, builder.add(b_place, _constant(LANES * v))), align=4)
        for v in range(vectors)
    ]
    a_place = builder.add(a_at, builder.mul(step, a_step))
    grown = []
    for row in range(rows):
        number = builder.load(builder.gep(a_data, [builder.add(a_place, builder.mul(a_row, _constant(row)))]))
        left = _splat(builder, number)
        grown += [_fma(builder, left, right[v], sums[row * vectors + v]) for v in range(vectors)]
    following = builder.add(step, _constant(1))
    builder.cbranch(builder.icmp_signed("<", following, depth), loop, after)
    for phi, start, grows in zip((step, *sums), (_constant(0), *first), (following, *grown), strict=True):
        phi.add_incoming(start, before)
        phi.add_incoming(grows, loop)
    builder.position_at_end(after)
    results = []
    for start, grows in zip(first, grown, strict=True):
        results.append(builder.phi(_VECTOR))
        results[-1].add_incoming(start, before)
        results[-1].add_incoming(grows, loop)
    for result, place in zip(results, _places(builder, y_at, y_row, rows, vectors), strict=True):
        builder.store(result, _vector_at(builder, y_data, place), align=4)


def tile_of(rows: int, vectors: int) -> Callable[..., None]:
    """``rows`` by ``vectors`` of C + A B, see `multiply`: the same elements, bit for bit, whatever its size."""
    if numba.config.DISABLE_JIT:
        return lambda *arguments: _plain_tile(rows, vectors * LANES, *arguments)

    @intrinsic
    def tile(
        typing_context: Any,
        a: Any, a_at: Any, a_row: Any, a_step: Any,
        b: Any, b_at: Any, b_step: Any, depth: Any,
        c: Any, c_at: Any, c_row: Any,
        y: Any, y_at: Any, y_row: Any,
    ) -> Any:  # fmt: skip
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            _write_tile(context, builder, signature, arguments, rows, vectors)
            return context.get_dummy_value()

        floats, whole = types.float32[::1], types.int64
        first = (floats, whole, whole, whole, floats, whole, whole, whole)
        return types.void(*first, floats, whole, whole, floats, whole, whole), generate

    return tile


def _plain_tile(
    rows: int, columns: int,
    a: Floats, a_at: int, a_row: int, a_step: int,
    b: Floats, b_at: int, b_step: int, depth: int,
    c: Floats, c_at: int, c_row: int,
    y: Floats, y_at: int, y_row: int,
) -> None:  # fmt: skip
    for row in range(rows):
        total = c[c_at + row * c_row :][:columns].copy()
        for step in range(depth):
            total += a[a_at + row * a_row + step * a_step] * b[b_at + step * b_step :][:columns]
        y[y_at + row * y_row :][:columns] = total


_block, _flat_wide = tile_of(*_BLOCK), tile_of(1, WIDE)
_tall, _flat = tile_of(_TALL, 1), tile_of(1, 1)


@njit
def multiply(
    rows: int,
    depth: int,
    columns: int,
    a: Floats,
    a_at: int,
    a_row: int,
    a_step: int,
    b: Floats,
    b_at: int,
    b_step: int,
    c: Floats,
    c_at: int,
    c_row: int,
    y: Floats,
    y_at: int,
    y_row: int,
) -> None:
    """Y = C + A B, of ``rows`` × ``columns``, a multiple of `LANES`; sums go along the ``depth``, from C on.

    Of each matrix: the array that it lies in, where it begins, and how far its rows are apart; of A also how far its
    columns are apart (so that it may be transposed), and of C rows may be the same (0 apart: a bias).
    """
    strip = WIDE * LANES
    in_strips = columns - columns % strip
    whole = rows - rows % _BLOCK[0]
    for begin in range(0, in_strips, strip):
        for column in range(begin, begin + strip, _BLOCK[1] * LANES):
            for row in range(0, whole, _BLOCK[0]):
                left, start, end = a_at + row * a_row, c_at + row * c_row + column, y_at + row * y_row + column
                _block(a, left, a_row, a_step, b, b_at + column, b_step, depth, c, start, c_row, y, end, y_row)
        for row in range(whole, rows):
            left, start, end = a_at + row * a_row, c_at + row * c_row + begin, y_at + row * y_row + begin
            _flat_wide(a, left, a_row, a_step, b, b_at + begin, b_step, depth, c, start, c_row, y, end, y_row)
    whole = rows - rows % _TALL
    for column in range(in_strips, columns, LANES):
        for row in range(0, whole, _TALL):
            left, start, end = a_at + row * a_row, c_at + row * c_row + column, y_at + row * y_row + column
            _tall(a, left, a_row, a_step, b, b_at + column, b_step, depth, c, start, c_row, y, end, y_row)
        for row in range(whole, rows):
            left, start, end = a_at + row * a_row, c_at + row * c_row + column, y_at + row * y_row + column
            _flat(a, left, a_row, a_step, b, b_at + column, b_step, depth, c, start, c_row, y, end, y_row)


def _sum_of_squares() -> Callable[[Floats, int, int], Any]:
    if numba.config.DISABLE_JIT:
        return lambda values, begin, end: np.square(values[begin:end]).sum()

    @intrinsic
    def summed(typing_context: Any, values: Any, begin: Any, end: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array, begin, end = arguments
            data = context.make_array(signature.args[0])(context, builder, array).data
            sums = cgutils.alloca_once_value(builder, ir.Constant(_VECTOR, [0.0] * LANES))
            with cgutils.for_range_slice(builder, begin, end, _constant(LANES), inc=True) as (place, _):
                vector = builder.load(_vector_at(builder, data, place), align=4)
                builder.store(_fma(builder, vector, vector, builder.load(sums)), sums)
            total, lanes = ir.Constant(ir.FloatType(), 0.0), builder.load(sums)
            for lane in range(LANES):
                number = builder.extract_element(lanes, ir.Constant(ir.IntType(32), lane))
                total = builder.fadd(total, number)
            return total

        return types.float32(types.float32[::1], types.int64, types.int64), generate

    return summed


sum_of_squares = _sum_of_squares()
"""Σ x² of ``values[begin:end]``, a multiple of `LANES`: so many sums side by side, then lane by lane."""


def _plain_rectify(values: Floats, begin: int, end: int) -> None:
    values[begin:end] = np.maximum(values[begin:end], np.float32(0.0))


def _rectify() -> Callable[[Floats, int, int], None]:
    if numba.config.DISABLE_JIT:
        return _plain_rectify

    @intrinsic
    def rectified(typing_context: Any, values: Any, begin: Any, end: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array, begin, end = arguments
            data = context.make_array(signature.args[0])(context, builder, array).data
            zeros = ir.Constant(_VECTOR, [0.0] * LANES)
            with cgutils.for_range_slice(builder, begin, end, _constant(LANES), inc=True) as (place, _):
                at = _vector_at(builder, data, place)
                vector = builder.load(at, align=4)
                larger = builder.select(builder.fcmp_ordered("<", vector, zeros), zeros, vector)
                builder.store(builder.fadd(larger, zeros), at, align=4)
            return context.get_dummy_value()

        return types.void(types.float32[::1], types.int64, types.int64), generate

    return rectified


rectify = _rectify()
"""max(x, 0) of ``values[begin:end]``, a multiple of `LANES`, in place; NaN stays, and −0 becomes 0.

Zeros are added since of a comparison alone the compiler makes a store of the zeros under a mask, for which some
processors take five times as long.
"""


def aligned(*shape: int) -> Floats:
    """Zeros, ``float32``, that begin at a multiple of 64 bytes; it matters for speed alone."""
    size = int(np.prod(shape, dtype=np.int64))
    room = np.zeros(size + LANES, dtype=np.float32)
    begin = (-room.ctypes.data // room.itemsize) % LANES
    return room[begin : begin + size].reshape(shape)
