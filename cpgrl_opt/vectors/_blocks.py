"""Compiled passes over g and the rows of J, block by block, wherever and however they lie.

    gramian              K = V Vᵀ,  V = [g; J]
    gramian_in_pairs     the same with 106 bits: K = hi + lo
    combine              d = Vᵀ(w + w′), in pairs summed with 106 bits and rounded once; r = d − g − Jᵀμ; r·r, J d, d·d
    measure              the measures of a d that is there already

Vectors may come in leaves. Row 0 of a leaf is g's part, row i that of Jᵢ; `where` holds the address of each, how many
bytes lie from one of its numbers to the next, how many numbers there are, and how many bytes one has; `places` the same
of d's part. All leaves of a call are of one dtype, float64, float32 or bfloat16, for which it is compiled.
Numbers that lie side by side are read where they are, others are gathered a block at a time. All sums are of float64,
in which products of shorter numbers are exact, and are added to what `out` and `sums` hold. Sums of a block may be
reordered by the compiler, always in the same way, so that an answer repeats; sums in pairs may not. What is written to
`places` is rounded to the leaves' dtype after it was measured.
Source of the pairs: Dekker 1971; Ogita, Rump & Oishi 2005, Algorithms 3.1, 3.3, 5.3. Importing this imports numba; each
pass is compiled, or loaded from the cache, when it is first called.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numba import carray, njit, types
from numba.extending import intrinsic, overload

from ..compensated import product_error, split, two_sum
from ..machine_code import CompiledLate, forget_outdated_kernels
from ._bfloat16 import narrow, widen

_FILE = Path(__file__)
forget_outdated_kernels(_FILE.parent, sources=[_FILE, _FILE.parents[1] / "compensated.py"])

_BLOCK = 1024  # six rows of it fit the first-level cache twice
_MOST_SUMS = 2_000_000  # in pairs, 32 MB: many rows get fewer lanes
_LANES = 256  # sums in pairs run side by side in so many lanes, so that the processor's vectors are full
# Rows that are gathered begin an odd number of cache lines apart: with a power of two all compete for the same lines of
# the first-level cache, and 31 rows take four times as long.
_APART = _BLOCK + 8
_COLUMNS = 16
# Of bfloat16 the bits.
_DTYPES = {np.dtype(np.float64): "f8", np.dtype(np.float32): "f4", np.dtype(np.uint16): "u2"}
_WHERE, _VECTOR = "Array(i8, 3, 'C', readonly=True)", "Array(f8, 1, 'C', readonly=True)"
_LIKE = "{0}[::1]"  # an empty array of the leaves' dtype
_PLACES, _SQUARE = "Array(i8, 2, 'C', readonly=True)", "f8[:, ::1]"


def _reordered(function: Any) -> Any:
    """Compiled with sums in any order, which makes them vector operations; NaN and infinity stay what they are."""
    return njit(fastmath={"reassoc", "contract", "nsz"}, error_model="numpy")(function)


def _plain(function: Any) -> Any:
    """Compiled as it stands."""
    return njit(error_model="numpy")(function)


_split, _product_error, _two_sum, _widen, _narrow = map(
    njit(error_model="numpy", forceinline=True), (split, product_error, two_sum, widen, narrow)
)


def _pass(first: str, *others: str) -> Any:
    """Compiled for each dtype when it is first met; first: signature of the first argument, which has the dtype."""
    signature = f"void({', '.join((first, *others))})"
    return lambda function: {dtype: CompiledLate(signature.format(code), function) for dtype, code in _DTYPES.items()}


def _numbers_at(address: int, count: int, like: Any) -> Any:
    """The numbers of a dtype that lie side by side from an address on."""
    kind = np.ctypeslib.as_ctypes_type(like.dtype)
    return np.ctypeslib.as_array((kind * int(count)).from_address(int(address)))


@intrinsic
def _pointer(_context: Any, _address: Any, like: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.CPointer(like.dtype)(types.int64, like), generate


@overload(_numbers_at, strict=False)
def _compiled_numbers_at(address: Any, count: Any, like: Any) -> Any:  # noqa: ARG001 - numba goes by the names
    def numbers(address: Any, count: Any, like: Any) -> Any:
        return carray(_pointer(address, like), count)

    return numbers


def _value(number: Any) -> Any:
    """In float64."""
    return np.float64(widen(number) if isinstance(number, np.uint16) else number)


@overload(_value, strict=False, jit_options={"forceinline": True})
def _compiled_value(number: Any) -> Any:
    if number == types.uint16:
        return lambda number: np.float64(_widen(number))
    return lambda number: np.float64(number)


def _rounded(number: Any, like: Any) -> Any:
    """In the dtype."""
    return narrow(number) if like.dtype == np.uint16 else number


@overload(_rounded, strict=False, jit_options={"forceinline": True})
def _compiled_rounded(number: Any, like: Any) -> Any:  # noqa: ARG001 - numba goes by the names
    if like.dtype == types.uint16:
        return lambda number, like: _narrow(number)  # noqa: ARG005
    return lambda number, like: number  # noqa: ARG005


@_pass("Array({0}, 1, 'A', readonly=True)", "Array({0}, 2, 'A', readonly=True)", "i8[:, ::1]")
def locate(first: Any, rows: Any, places: Any) -> None:
    """The first places ← address, bytes from one number to the next, numbers, and bytes of one; of each vector.

    NumPy's `__array_interface__` takes several times as long: it describes what nobody reads.
    """
    places[0, 0], places[0, 1], places[0, 2] = first.ctypes.data, first.strides[0], first.shape[0]
    for i in range(rows.shape[0]):
        places[1 + i, 0] = rows.ctypes.data + i * rows.strides[0]
        places[1 + i, 1], places[1 + i, 2] = rows.strides[1], rows.shape[1]
    places[: 1 + rows.shape[0], 3] = first.itemsize


@_plain
def _gather(where: Any, start: int, width: int, buffer: Any) -> None:
    """Rows of the buffer ← the block of those that do not lie ready; some columns at a time, which may be neighbours.

    Column by column, loops over five rows take twice as long to start as to run.
    """
    apart = False
    for i in range(where.shape[0]):
        apart = apart or where[i, 1] != buffer.itemsize
    if apart:
        for first in range(0, width, _COLUMNS):
            for i in range(where.shape[0]):
                step, address = where[i, 1], where[i, 0] + start * where[i, 1]
                if step != buffer.itemsize:
                    for t in range(first, min(first + _COLUMNS, width)):
                        buffer[i, t] = _numbers_at(address + t * step, 1, buffer)[0]


@_plain
def _row(where: Any, i: int, start: int, width: int, buffer: Any) -> Any:
    """A block of row i, where it lies or as it was gathered."""
    if where[i, 1] == buffer.itemsize:
        return _numbers_at(where[i, 0] + start * buffer.itemsize, width, buffer)
    return buffer[i, :width]


@_reordered
def _nine_inner(a: Any, b: Any, c: Any, x: Any, y: Any, z: Any) -> Any:
    """a·x, a·y … c·z: each number loaded serves three products, and nine sums still fit the registers."""
    ax, ay, az, bx, by, bz, cx, cy, cz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for t in range(a.shape[0]):
        p, q, r = _value(a[t]), _value(b[t]), _value(c[t])
        u, v, w = _value(x[t]), _value(y[t]), _value(z[t])
        ax += p * u
        ay += p * v
        az += p * w
        bx += q * u
        by += q * v
        bz += q * w
        cx += r * u
        cy += r * v
        cz += r * w
    return (ax, ay, az), (bx, by, bz), (cx, cy, cz)


@_reordered
def _six_inner(a: Any, b: Any, c: Any) -> Any:
    """The lower triangle of three with each other."""
    aa, ba, bb, ca, cb, cc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for t in range(a.shape[0]):
        p, q, r = _value(a[t]), _value(b[t]), _value(c[t])
        aa += p * p
        ba += q * p
        bb += q * q
        ca += r * p
        cb += r * q
        cc += r * r
    return (aa, 0.0, 0.0), (ba, bb, 0.0), (ca, cb, cc)


@_reordered
def _three_inner(d: Any, x: Any, y: Any, z: Any) -> tuple[float, float, float]:
    a, b, c = 0.0, 0.0, 0.0
    for t in range(d.shape[0]):
        a += d[t] * _value(x[t])
        b += d[t] * _value(y[t])
        c += d[t] * _value(z[t])
    return a, b, c


@_reordered
def _rest_and_length(d: Any, forced: Any) -> tuple[float, float]:
    rest, length = 0.0, 0.0
    for t in range(d.shape[0]):
        rest += (d[t] - forced[t]) * (d[t] - forced[t])
        length += d[t] * d[t]
    return rest, length


@_reordered
def _add_three(total: Any, a: float, b: float, c: float, x: Any, y: Any, z: Any) -> None:
    """total += a x + b y + c z."""
    for t in range(total.shape[0]):
        total[t] += a * _value(x[t]) + b * _value(y[t]) + c * _value(z[t])


@_plain
def _chosen(weights: Any) -> Any:
    """Rows whose weight is not 0, and these weights; filled up to threes with weights of 0."""
    rows, chosen, count = np.zeros(len(weights) + 2, np.int64), np.zeros(len(weights) + 2), 0
    for i in range(len(weights)):
        if weights[i] != 0.0:
            rows[count], chosen[count] = i, weights[i]
            count += 1
    rows[count:] = rows[max(count - 1, 0)]
    return rows, chosen, count


@_plain
def _combine_block(total: Any, chosen: tuple[Any, ...], where: Any, start: int, buffer: Any) -> None:
    """total += Σ weightsᵢ rowᵢ."""
    rows, weights, count = chosen
    width = total.shape[0]
    for i in range(0, count, 3):
        x = _row(where, rows[i], start, width, buffer)
        y = _row(where, rows[i + 1], start, width, buffer)
        z = _row(where, rows[i + 2], start, width, buffer)
        _add_three(total, weights[i], weights[i + 1], weights[i + 2], x, y, z)


@_plain
def _measure_block(d: Any, forced: Any, where: Any, start: int, buffer: Any, sums: Any) -> None:
    """sums += [r·r, J d …, d·d] of a block, r = d − forced."""
    m, width = where.shape[0] - 1, d.shape[0]
    for i in range(1, m + 1, 3):
        x = _row(where, i, start, width, buffer)
        y = _row(where, min(i + 1, m), start, width, buffer)
        products = _three_inner(d, x, y, _row(where, min(i + 2, m), start, width, buffer))
        for k in range(min(3, m + 1 - i)):
            sums[i + k] += products[k]
    rest, length = _rest_and_length(d, forced)
    sums[0] += rest
    sums[1 + m] += length


@_plain
def _add_inner(where: Any, start: int, width: int, buffer: Any, out: Any) -> None:
    """The lower triangle of out += K of a block."""
    count = where.shape[0]
    for i in range(0, count, 3):
        a = _row(where, i, start, width, buffer)
        b = _row(where, min(i + 1, count - 1), start, width, buffer)
        c = _row(where, min(i + 2, count - 1), start, width, buffer)
        for j in range(0, i + 1, 3):
            if j == i:
                sums = _six_inner(a, b, c)
            else:
                x = _row(where, j, start, width, buffer)
                y = _row(where, j + 1, start, width, buffer)
                sums = _nine_inner(a, b, c, x, y, _row(where, j + 2, start, width, buffer))
            for k in range(min(3, count - i)):
                for q in range(min(3, i + k - j + 1)):
                    out[i + k, j + q] += sums[k][q]


@_pass(_LIKE, _WHERE, _SQUARE)
def gramian(like: Any, where: Any, out: Any) -> None:
    """out += K."""
    buffer = np.empty((where.shape[1], _APART), like.dtype)
    for leaf in range(len(where)):
        for start in range(0, where[leaf, 0, 2], _BLOCK):
            width = min(_BLOCK, where[leaf, 0, 2] - start)
            _gather(where[leaf], start, width, buffer)
            _add_inner(where[leaf], start, width, buffer, out)
    _mirror(out)


@_plain
def _mirror(lower: Any) -> None:
    """The upper triangle ← the lower."""
    for i in range(lower.shape[0]):
        for j in range(i):
            lower[j, i] = lower[i, j]


@_plain
def _split_row(x: Any, high: Any, low: Any) -> None:
    for t in range(x.shape[0]):
        high[t], low[t] = _split(_value(x[t]))


@_plain
def _add_products(x: Any, x_high: Any, x_low: Any, y: Any, y_high: Any, y_low: Any, total: Any, rest: Any) -> None:
    """total + rest += x·y, each lane by itself and without rounding, but for what 106 bits do not hold."""
    for t in range(x.shape[0]):
        product = _value(x[t]) * _value(y[t])
        error = _product_error(product, x_high[t], x_low[t], y_high[t], y_low[t])
        total[t], lost = _two_sum(total[t], product)
        rest[t] += error + lost


@_plain
def _sum_pairs(high: float, low: float, total: Any, rest: Any) -> tuple[float, float]:
    for t in range(total.shape[0]):
        high, lost = _two_sum(high, total[t])
        low += rest[t] + lost
    return high + low, low - ((high + low) - high)


@_plain
def _add_inner_in_pairs(
    where: Any, start: int, width: int, buffer: Any, high: Any, low: Any, totals: Any, rests: Any
) -> None:
    """totals + rests += K of a block, lane by lane."""
    for i in range(where.shape[0]):
        x, x_high, x_low = _row(where, i, start, width, buffer), high[i, :width], low[i, :width]
        _split_row(x, x_high, x_low)
        for j in range(i + 1):
            y, y_high, y_low = _row(where, j, start, width, buffer), high[j, :width], low[j, :width]
            _add_products(x, x_high, x_low, y, y_high, y_low, totals[i, j, :width], rests[i, j, :width])


@_pass(_LIKE, _WHERE, _SQUARE, _SQUARE)
def gramian_in_pairs(like: Any, where: Any, out: Any, out_low: Any) -> None:
    """out + out_low += K, each number of 106 bits; few rows get many lanes, many rows few."""
    count = where.shape[1]
    lanes = max(8, min(_LANES, _MOST_SUMS // (count * count) // 8 * 8))
    buffer, high, low = np.empty((count, lanes + 8), like.dtype), np.empty((count, lanes)), np.empty((count, lanes))
    totals, rests = np.zeros((count, count, lanes)), np.zeros((count, count, lanes))
    for leaf in range(len(where)):
        for start in range(0, where[leaf, 0, 2], lanes):
            width = min(lanes, where[leaf, 0, 2] - start)
            _gather(where[leaf], start, width, buffer)
            _add_inner_in_pairs(where[leaf], start, width, buffer, high, low, totals, rests)
    for i in range(count):
        for j in range(i + 1):
            out[i, j], out_low[i, j] = _sum_pairs(out[i, j], out_low[i, j], totals[i, j], rests[i, j])
    _mirror(out)
    _mirror(out_low)


@_plain
def _add_multiple(weight: float, more: float, x: Any, total: Any, rest: Any) -> None:
    """total + rest += (weight + more) x."""
    high, low = _split(weight)
    for t in range(x.shape[0]):
        number = _value(x[t])
        x_high, x_low = _split(number)
        product = weight * number
        error = _product_error(product, x_high, x_low, high, low)
        total[t], lost = _two_sum(total[t], product)
        rest[t] += (error + more * number) + lost


@_plain
def _combine_block_in_pairs(d: Any, rest: Any, weights: Any, more: Any, where: Any, start: int, buffer: Any) -> None:
    """d ← Σ (weightsᵢ + moreᵢ) rowᵢ, rounded once."""
    rest[:] = 0.0
    for i in range(weights.shape[0]):
        if weights[i] != 0.0 or more[i] != 0.0:
            _add_multiple(weights[i], more[i], _row(where, i, start, d.shape[0], buffer), d, rest)
    for t in range(d.shape[0]):
        d[t] += rest[t]


@_plain
def _block_of(place: Any, start: int, width: int, block: Any) -> Any:
    """Where a block of d is made: its place, or beside it."""
    return _numbers_at(place[0] + start * block.itemsize, width, block) if place[3] == block.itemsize else block[:width]


@_plain
def _round_into(place: Any, start: int, d: Any, like: Any) -> None:
    """The block of the place ← d, in its dtype; nothing where d is that block."""
    if place[3] != d.itemsize:
        rounded = _numbers_at(place[0] + start * like.itemsize, d.shape[0], like)
        for t in range(d.shape[0]):
            rounded[t] = _rounded(d[t], like)


@_plain
def _widen_into(d: Any, place: Any, start: int, like: Any) -> None:
    """d ← the block of the place; nothing where d is that block."""
    if place[3] != d.itemsize:
        numbers = _numbers_at(place[0] + start * like.itemsize, d.shape[0], like)
        for t in range(d.shape[0]):
            d[t] = _value(numbers[t])


@_pass(_LIKE, _WHERE, _VECTOR, _VECTOR, _VECTOR, _PLACES, "f8[::1]")
def combine(like: Any, where: Any, weights: Any, more: Any, forces: Any, places: Any, sums: Any) -> None:
    """places ← Vᵀ(weights + more), in pairs where there is more; sums += [r·r, J d …, d·d], r = d − Vᵀforces."""
    forced, rest, block = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    buffer = np.empty((where.shape[1], _APART), like.dtype)
    chosen, chosen_forces = _chosen(weights), _chosen(forces)
    pairs = more.any()
    is_forced = not pairs and (weights == forces).all()  # d is this sum itself: nothing is left of it
    for leaf in range(len(where)):
        for start in range(0, where[leaf, 0, 2], _BLOCK):
            width = min(_BLOCK, where[leaf, 0, 2] - start)
            d = _block_of(places[leaf], start, width, block)
            _gather(where[leaf], start, width, buffer)
            d[:] = 0.0
            if pairs:
                _combine_block_in_pairs(d, rest[:width], weights, more, where[leaf], start, buffer)
            else:
                _combine_block(d, chosen, where[leaf], start, buffer)
            if is_forced:
                _measure_block(d, d, where[leaf], start, buffer, sums)
            else:
                forced[:width] = 0.0
                _combine_block(forced[:width], chosen_forces, where[leaf], start, buffer)
                _measure_block(d, forced[:width], where[leaf], start, buffer, sums)
            _round_into(places[leaf], start, d, like)


@_pass(_LIKE, _WHERE, _PLACES, _VECTOR, "f8[::1]")
def measure(like: Any, where: Any, places: Any, forces: Any, sums: Any) -> None:
    """sums += [r·r, J d …, d·d] of the d that lies in the places, side by side; of float64 or the leaves' dtype."""
    forced, block = np.empty(_BLOCK), np.empty(_BLOCK)
    buffer = np.empty((where.shape[1], _APART), like.dtype)
    chosen = _chosen(forces)
    for leaf in range(len(where)):
        for start in range(0, where[leaf, 0, 2], _BLOCK):
            width = min(_BLOCK, where[leaf, 0, 2] - start)
            d = _block_of(places[leaf], start, width, block)
            _widen_into(d, places[leaf], start, like)
            _gather(where[leaf], start, width, buffer)
            forced[:width] = 0.0
            _combine_block(forced[:width], chosen, where[leaf], start, buffer)
            _measure_block(d, forced[:width], where[leaf], start, buffer, sums)
