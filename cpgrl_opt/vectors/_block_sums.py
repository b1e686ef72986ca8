"""Sums over one block of a few rows, for the passes of `_blocks`, which compile them for their dtype.

Sums of a block may be reordered by the compiler, always in the same way, so that an answer repeats; sums in pairs may
not. Importing this imports numba.
"""

from typing import Any

import numpy as np
from numba import carray, njit, types
from numba.extending import intrinsic, overload

from ..compensated import product_error, split, two_sum
from ._bfloat16 import narrow, widen

# Sums in any order, which makes them vector operations; NaN and infinity stay what they are.
_reordered = njit(fastmath={"reassoc", "contract", "nsz"}, error_model="numpy")
plain = njit(error_model="numpy")
_helper = njit(error_model="numpy", forceinline=True)
_split, _product_error, _two_sum, _widen, _narrow = map(_helper, (split, product_error, two_sum, widen, narrow))


def numbers_at(address: int, count: int, like: Any) -> Any:
    """The numbers of a dtype that lie side by side from an address on."""
    kind = np.ctypeslib.as_ctypes_type(like.dtype)
    return np.ctypeslib.as_array((kind * int(count)).from_address(int(address)))


@intrinsic
def _pointer(_context: Any, _address: Any, like: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.CPointer(like.dtype)(types.int64, like), generate


@overload(numbers_at, strict=False)
def _compiled_numbers_at(address: Any, count: Any, like: Any) -> Any:  # noqa: ARG001 - numba goes by the names
    return lambda address, count, like: carray(_pointer(address, like), count)


def value(number: Any) -> Any:
    """In float64."""
    return np.float64(widen(number) if isinstance(number, np.uint16) else number)


@overload(value, strict=False, jit_options={"forceinline": True})
def _compiled_value(number: Any) -> Any:
    if number == types.uint16:
        return lambda number: np.float64(_widen(number))
    return lambda number: np.float64(number)


def rounded(number: Any, like: Any) -> Any:
    """In the dtype."""
    return narrow(number) if like.dtype == np.uint16 else number


@overload(rounded, strict=False, jit_options={"forceinline": True})
def _compiled_rounded(number: Any, like: Any) -> Any:  # noqa: ARG001 - numba goes by the names
    if like.dtype == types.uint16:
        return lambda number, like: _narrow(number)  # noqa: ARG005
    return lambda number, like: number  # noqa: ARG005


@_reordered
def nine_inner(a: Any, b: Any, c: Any, x: Any, y: Any, z: Any) -> Any:
    """a·x, a·y … c·z: each number loaded serves three products, and nine sums still fit the registers."""
    ax, ay, az, bx, by, bz, cx, cy, cz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for t in range(a.shape[0]):
        p, q, r = value(a[t]), value(b[t]), value(c[t])
        u, v, w = value(x[t]), value(y[t]), value(z[t])
        ax, ay, az = ax + p * u, ay + p * v, az + p * w
        bx, by, bz = bx + q * u, by + q * v, bz + q * w
        cx, cy, cz = cx + r * u, cy + r * v, cz + r * w
    return (ax, ay, az), (bx, by, bz), (cx, cy, cz)


@_reordered
def six_inner(a: Any, b: Any, c: Any) -> Any:
    """The lower triangle of three with each other."""
    aa, ba, bb, ca, cb, cc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for t in range(a.shape[0]):
        p, q, r = value(a[t]), value(b[t]), value(c[t])
        aa, ba, bb = aa + p * p, ba + q * p, bb + q * q
        ca, cb, cc = ca + r * p, cb + r * q, cc + r * r
    return (aa, 0.0, 0.0), (ba, bb, 0.0), (ca, cb, cc)


@_reordered
def three_inner(d: Any, x: Any, y: Any, z: Any) -> tuple[float, float, float]:
    """d·x, d·y, d·z."""
    a, b, c = 0.0, 0.0, 0.0
    for t in range(d.shape[0]):
        a, b, c = a + d[t] * value(x[t]), b + d[t] * value(y[t]), c + d[t] * value(z[t])
    return a, b, c


@_reordered
def rest_and_length(d: Any, forced: Any) -> tuple[float, float]:
    """(d − forced)·(d − forced), d·d."""
    rest, length = 0.0, 0.0
    for t in range(d.shape[0]):
        rest += (d[t] - forced[t]) * (d[t] - forced[t])
        length += d[t] * d[t]
    return rest, length


@_reordered
def add_three(total: Any, a: float, b: float, c: float, x: Any, y: Any, z: Any) -> None:
    """total += a x + b y + c z."""
    for t in range(total.shape[0]):
        total[t] += a * value(x[t]) + b * value(y[t]) + c * value(z[t])


@plain
def split_row(x: Any, high: Any, low: Any) -> None:
    """Each number of x into halves."""
    for t in range(x.shape[0]):
        high[t], low[t] = _split(value(x[t]))


@plain
def add_products(x: Any, x_high: Any, x_low: Any, y: Any, y_high: Any, y_low: Any, total: Any, rest: Any) -> None:
    """total + rest += x·y, each lane by itself and without rounding, but for what 106 bits do not hold."""
    for t in range(x.shape[0]):
        product = value(x[t]) * value(y[t])
        error = _product_error(product, x_high[t], x_low[t], y_high[t], y_low[t])
        total[t], lost = _two_sum(total[t], product)
        rest[t] += error + lost


@plain
def sum_pairs(high: float, low: float, total: Any, rest: Any) -> tuple[float, float]:
    """(high, low) + Σ (total + rest)."""
    for t in range(total.shape[0]):
        high, lost = _two_sum(high, total[t])
        low += rest[t] + lost
    return high + low, low - ((high + low) - high)


@plain
def add_multiple(weight: float, more: float, x: Any, total: Any, rest: Any) -> None:
    """total + rest += (weight + more) x."""
    high, low = _split(weight)
    for t in range(x.shape[0]):
        number = value(x[t])
        x_high, x_low = _split(number)
        product = weight * number
        error = _product_error(product, x_high, x_low, high, low)
        total[t], lost = _two_sum(total[t], product)
        rest[t] += (error + more * number) + lost
