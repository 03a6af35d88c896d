"""Elementary functions that give the same bits on every machine.

A compiler neither reorders nor fuses what is written here. Each fused product and sum stands as such, and IEEE 754
rounds it once, whether a processor has an instruction for it or not. Nothing is taken from the machine's mathematical
library, which differs from one to another, and is slow, since it is called for every element.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from apel.numerics.compiled import njit


def _fused(number: Any) -> Callable[[Any, Any, Any], Any]:
    if numba.config.DISABLE_JIT:
        return lambda a, b, c: a * b + c  # for debuggers

    @intrinsic
    def fused(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
        return number(number, number, number), lambda _, builder, __, arguments: builder.fma(*arguments)

    return fused


def _reinterpreted(source: Any, target: Any, plain: Any, llvm: ir.Type) -> Callable[[Any], Any]:
    if numba.config.DISABLE_JIT:
        return lambda number: np.array(number).view(plain)[()]

    @intrinsic
    def bits(typing_context: Any, number: Any) -> Any:
        return target(source), lambda _, builder, __, arguments: builder.bitcast(arguments[0], llvm)

    return bits


fma = _fused(types.float64)
"""a · b + c of ``float64``, rounded once."""
fma32 = _fused(types.float32)
"""The same of ``float32``."""
_float_of = _reinterpreted(types.int64, types.float64, np.float64, ir.DoubleType())
_bits_of = _reinterpreted(types.float64, types.int64, np.int64, ir.IntType(64))
_float32_of = _reinterpreted(types.int32, types.float32, np.float32, ir.FloatType())

_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_SQRT_HALF_BITS = 0x3FE6A09E667F3BCD
_ONE_BITS = 0x3FF0000000000000
_MANTISSA = 52
_LARGEST, _SMALLEST = 709.78, -708.39
# Of 2⁻ⁿ and n: enough to add and take away, so that a float is rounded to a whole number.
_ROUNDER = 6755399441055744.0


@njit(inline="always")
def exp(x: float) -> float:
    """eˣ of a ``float64`` to the last bit or two; never below the smallest normal number."""
    x = max(_SMALLEST, min(_LARGEST, x)) if x == x else x
    n = fma(x, _LOG2_E, _ROUNDER) - _ROUNDER
    r = fma(-n, _LN2_LOW, fma(-n, _LN2_HIGH, x))
    p = fma(r, 1.6059043836821613e-10, 2.08767569878681e-09)  # 1 / 13!, 1 / 12!
    p = fma(r, p, 2.505210838544172e-08)
    p = fma(r, p, 2.755731922398589e-07)
    p = fma(r, p, 2.7557319223985893e-06)
    p = fma(r, p, 2.48015873015873e-05)
    p = fma(r, p, 1.984126984126984e-04)
    p = fma(r, p, 1.388888888888889e-03)
    p = fma(r, p, 8.333333333333333e-03)
    p = fma(r, p, 4.1666666666666664e-02)
    p = fma(r, p, 1.6666666666666666e-01)
    p = fma(r, p, 0.5)
    p = fma(r, p, 1.0)
    return fma(r, p, 1.0) * _float_of((np.int64(n) + np.int64(1023)) << np.int64(_MANTISSA))


@njit(inline="always")
def log(x: float) -> float:
    """Ln x of a normal ``float64`` above 0, to the last bit or two (after Sun's fdlibm)."""
    bits = _bits_of(x)
    exponent = (bits - np.int64(_SQRT_HALF_BITS)) >> np.int64(_MANTISSA)
    f = _float_of(bits - (exponent << np.int64(_MANTISSA))) - 1.0
    k = np.float64(exponent)
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    even = w * fma(w, fma(w, 1.531383769920937332e-01, 2.222219843214978396e-01), 3.999999999940941908e-01)
    odd = z * fma(
        w, fma(w, fma(w, 1.479819860511658591e-01, 1.818357216161805012e-01), 2.857142874366239149e-01),
        6.666666666666735130e-01,
    )  # fmt: skip
    half = 0.5 * f * f
    return k * _LN2_HIGH - ((half - fma(s, half + (even + odd), k * _LN2_LOW)) - f)


_F = np.float32


@njit(inline="always")
def tanh32(x: Any) -> Any:
    """The hyperbolic tangent of a ``float32`` to the last bit or two, without a branch (after Moshier's Cephes)."""
    size = min(abs(x), _F(9.5))
    z = size * size
    p = fma32(z, _F(-5.70498872745e-3), _F(2.06390887954e-2))
    p = fma32(z, p, _F(-5.37397155531e-2))
    p = fma32(z, p, _F(1.33314422036e-1))
    p = fma32(z, p, _F(-3.33332819422e-1))
    small = fma32(z * p, size, size)
    # 1 − 2 / (e²ˣ + 1).
    t = size + size
    n = fma32(t, _F(1.44269504088896341), _F(12582912.0)) - _F(12582912.0)
    r = fma32(-n, _F(2.12194440e-4) * _F(-1.0), fma32(-n, _F(0.693359375), t))
    q = fma32(r, _F(1.9875691500e-4), _F(1.3981999507e-3))
    q = fma32(r, q, _F(8.3334519073e-3))
    q = fma32(r, q, _F(4.1665795894e-2))
    q = fma32(r, q, _F(1.6666665459e-1))
    q = fma32(r, q, _F(5.0000001201e-1))
    q = fma32(r * r, q, r) + _F(1.0)
    power = q * _float32_of((np.int32(n) + np.int32(127)) << np.int32(23))
    large = _F(1.0) - _F(2.0) / (power + _F(1.0))
    found = small if size < _F(0.625) else large
    return -found if x < _F(0.0) else found


@njit(inline="always")
def power(base: float, exponent: int) -> float:
    """``base`` to the ``exponent`` ≥ 0, by squaring."""
    result = 1.0
    while exponent > 0:
        if exponent & 1:
            result *= base
        base *= base
        exponent >>= 1
    return result


@njit(inline="always")
def real_power(base: float, exponent: float) -> float:
    """``base`` ≥ 0 to a real ``exponent``, to 1e-13 or so; exact where that is 0 or 1."""
    if exponent == 0.0:
        return 1.0
    if exponent == 1.0 or base == 0.0:
        return base
    return exp(exponent * log(base))


@njit(inline="always")
def softmax(logits: Any, probability: Any) -> float:
    """Write the probabilities of ``logits`` ``[actions]``, in double precision; log Σ exp of the logits.

    In line, so that who does not want the latter does not wait for it: it is a third of the time.
    """
    largest = np.float64(logits[0])
    for i in range(1, logits.shape[0]):
        largest = max(largest, np.float64(logits[i]))
    total = 0.0
    for i in range(logits.shape[0]):
        probability[i] = exp(np.float64(logits[i]) - largest)
        total += probability[i]
    for i in range(logits.shape[0]):
        probability[i] /= total
    return largest + log(total)
