"""Compiled passes over g and the rows of J, block by block, wherever and however they lie.

    gramian              K = V Vᵀ,  V = [g; J]
    gramian_in_pairs     the same with 106 bits: K = hi + lo
    combine              d = Vᵀ(w + w′), in pairs summed with 106 bits and rounded once, or a d that is there already;
                         r = d − g − Jᵀμ; r·r, J d, d·d

Vectors may come in leaves. Row 0 of a leaf is g's part, row i that of Jᵢ; `where` holds the address of each, how many
bytes lie from one of its numbers to the next, how many numbers there are, and how many bytes one has. All leaves of a
call are of one dtype, float64, float32 or bfloat16, for which it is compiled.
Numbers that lie side by side are read where they are, others are gathered a block at a time. All sums are of float64,
in which products of shorter numbers are exact, and are added to what `out` and `sums` hold. What is written to d is
rounded to the leaves' dtype after it was measured.
Source of the pairs: Dekker 1971; Ogita, Rump & Oishi 2005, Algorithms 3.1, 3.3, 5.3. Importing this imports numba; each
pass is compiled, or loaded from the cache, when it is first called.
"""

from pathlib import Path
from typing import Any

import numpy as np

from ..machine_code import CompiledLate, forget_outdated_kernels
from . import _block_sums as block
from ._block_sums import plain

_FOLDER = Path(__file__).parent
forget_outdated_kernels(_FOLDER, sources=[*_FOLDER.glob("_b*.py"), _FOLDER.parent / "compensated.py"])

_BLOCK = 1024  # six rows of it fit the first-level cache twice
_MOST_SUMS = 2_000_000  # in pairs, 32 MB: many rows get fewer lanes
_LANES = 256  # sums in pairs run side by side in so many lanes, so that the processor's vectors are full
# Rows that are gathered begin an odd number of cache lines apart: with a power of two all compete for the same lines of
# the first-level cache, and 31 rows take four times as long.
_APART = _BLOCK + 8
_COLUMNS = 16  # gathered at a time: two cache lines of float64 of each row, if columns are neighbours
MANY = 32  # arrays whose addresses are asked for at a time
# Of bfloat16 the bits.
_DTYPES = {np.dtype(np.float64): "f8", np.dtype(np.float32): "f4", np.dtype(np.uint16): "u2"}
_WHERE, _PLACES = "Array(i8, 3, 'C', readonly=True)", "Array(i8, 2, 'C', readonly=True)"
_VECTOR, _SQUARE = "Array(f8, 1, 'C', readonly=True)", "f8[:, ::1]"


def _pass(*arguments: str) -> Any:
    """Compiled for each dtype when it is first met; arguments: their signatures, {0} for the dtype."""
    signature = f"void({', '.join(arguments)})"
    return lambda function: {dtype: CompiledLate(signature.format(code), function) for dtype, code in _DTYPES.items()}


@_pass("Array({0}, 1, 'A', readonly=True)", "Array({0}, 2, 'A', readonly=True)", "i8[:, ::1]")
def locate(vector: Any, rows: Any, places: Any) -> None:
    """The first places ← address, bytes from one number to the next, numbers, bytes of one; of the vector, each row.

    NumPy's `__array_interface__` takes several times as long: it describes what nobody reads.
    """
    places[0, 0], places[0, 1] = vector.ctypes.data, vector.strides[0]
    for i in range(rows.shape[0]):
        places[1 + i, 0], places[1 + i, 1] = rows.ctypes.data + i * rows.strides[0], rows.strides[1]
    for i in range(1 + rows.shape[0]):
        places[i, 2], places[i, 3] = vector.shape[0], vector.itemsize


@_pass(f"UniTuple(Array({{0}}, 1, 'C', readonly=True), {MANY})", "i8[::1]")
def find_addresses(arrays: Any, places: Any) -> None:
    """The first places ← addresses of so many arrays; to hand over one at a time takes six times as long."""
    for i in range(len(places)):
        places[i] = arrays[i].ctypes.data


@plain
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
                        buffer[i, t] = block.numbers_at(address + t * step, 1, buffer)[0]


@plain
def _row(where: Any, i: int, start: int, width: int, buffer: Any) -> Any:
    """A block of row i, where it lies or as it was gathered."""
    if where[i, 1] == buffer.itemsize:
        return block.numbers_at(where[i, 0] + start * buffer.itemsize, width, buffer)
    return buffer[i, :width]


@plain
def _mirror(lower: Any) -> None:
    """The upper triangle ← the lower."""
    for i in range(lower.shape[0]):
        for j in range(i):
            lower[j, i] = lower[i, j]


@plain
def _add_inner(where: Any, start: int, width: int, buffer: Any, out: Any) -> None:
    """The lower triangle of out += K of a block."""
    count = where.shape[0]
    for i in range(0, count, 3):
        a = _row(where, i, start, width, buffer)
        b = _row(where, min(i + 1, count - 1), start, width, buffer)
        c = _row(where, min(i + 2, count - 1), start, width, buffer)
        for j in range(0, i + 1, 3):
            if j == i:
                sums = block.six_inner(a, b, c)
            else:
                x = _row(where, j, start, width, buffer)
                y = _row(where, j + 1, start, width, buffer)
                sums = block.nine_inner(a, b, c, x, y, _row(where, j + 2, start, width, buffer))
            for k in range(min(3, count - i)):
                for q in range(min(3, i + k - j + 1)):
                    out[i + k, j + q] += sums[k][q]


@_pass("{0}[::1]", _WHERE, _SQUARE)
def gramian(like: Any, where: Any, out: Any) -> None:
    """out += K; like: an empty array of the leaves' dtype."""
    buffer = np.empty((where.shape[1], _APART), like.dtype)
    for leaf in range(len(where)):
        for start in range(0, where[leaf, 0, 2], _BLOCK):
            width = min(_BLOCK, where[leaf, 0, 2] - start)
            _gather(where[leaf], start, width, buffer)
            _add_inner(where[leaf], start, width, buffer, out)
    _mirror(out)


@plain
def _add_inner_in_pairs(
    where: Any, start: int, width: int, buffer: Any, high: Any, low: Any, totals: Any, rests: Any
) -> None:
    """totals + rests += K of a block, lane by lane."""
    for i in range(where.shape[0]):
        x, x_high, x_low = _row(where, i, start, width, buffer), high[i, :width], low[i, :width]
        block.split_row(x, x_high, x_low)
        for j in range(i + 1):
            y, y_high, y_low = _row(where, j, start, width, buffer), high[j, :width], low[j, :width]
            block.add_products(x, x_high, x_low, y, y_high, y_low, totals[i, j, :width], rests[i, j, :width])


@_pass("{0}[::1]", _WHERE, _SQUARE, _SQUARE)
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
            out[i, j], out_low[i, j] = block.sum_pairs(out[i, j], out_low[i, j], totals[i, j], rests[i, j])
    _mirror(out)
    _mirror(out_low)


@plain
def _choose(weights: Any) -> Any:
    """Rows whose weight is not 0, and these weights; filled up to threes with weights of 0."""
    rows, chosen, count = np.zeros(len(weights) + 2, np.int64), np.zeros(len(weights) + 2), 0
    for i in range(len(weights)):
        if weights[i] != 0.0:
            rows[count], chosen[count] = i, weights[i]
            count += 1
    rows[count:] = rows[max(count - 1, 0)]
    return rows, chosen, count


@plain
def _combine_block(total: Any, chosen: tuple[Any, ...], where: Any, start: int, buffer: Any) -> None:
    """total ← Σ weightsᵢ rowᵢ."""
    rows, weights, count = chosen
    width = total.shape[0]
    total[:] = 0.0
    for i in range(0, count, 3):
        x = _row(where, rows[i], start, width, buffer)
        y = _row(where, rows[i + 1], start, width, buffer)
        z = _row(where, rows[i + 2], start, width, buffer)
        block.add_three(total, weights[i], weights[i + 1], weights[i + 2], x, y, z)


@plain
def _combine_block_in_pairs(d: Any, rest: Any, weights: Any, more: Any, where: Any, start: int, buffer: Any) -> None:
    """d ← Σ (weightsᵢ + moreᵢ) rowᵢ, rounded once."""
    d[:], rest[:] = 0.0, 0.0
    for i in range(weights.shape[0]):
        if weights[i] != 0.0 or more[i] != 0.0:
            block.add_multiple(weights[i], more[i], _row(where, i, start, d.shape[0], buffer), d, rest)
    for t in range(d.shape[0]):
        d[t] += rest[t]


@plain
def _measure_block(d: Any, forced: Any, where: Any, start: int, buffer: Any, sums: Any) -> None:
    """sums += [r·r, J d …, d·d] of a block, r = d − forced."""
    m, width = where.shape[0] - 1, d.shape[0]
    for i in range(1, m + 1, 3):
        x = _row(where, i, start, width, buffer)
        y = _row(where, min(i + 1, m), start, width, buffer)
        products = block.three_inner(d, x, y, _row(where, min(i + 2, m), start, width, buffer))
        for k in range(min(3, m + 1 - i)):
            sums[i + k] += products[k]
    rest, length = block.rest_and_length(d, forced)
    sums[0] += rest
    sums[1 + m] += length


@plain
def _widen(address: int, like: Any, d: Any) -> None:
    """d ← what lies at the address, in the dtype."""
    given = block.numbers_at(address, d.shape[0], like)
    for t in range(d.shape[0]):
        d[t] = block.value(given[t])


@plain
def _narrow(d: Any, address: int, like: Any) -> None:
    """The other way."""
    given = block.numbers_at(address, d.shape[0], like)
    for t in range(d.shape[0]):
        given[t] = block.rounded(d[t], like)


@_pass("{0}[::1]", _WHERE, _VECTOR, _VECTOR, _VECTOR, _PLACES, "f8[::1]")
def combine(whole: Any, where: Any, weights: Any, more: Any, forces: Any, places: Any, sums: Any) -> None:
    """whole ← d = Vᵀ(weights + more), in pairs where there is more, leaf after leaf; sums += [r·r, J d …, d·d].

    r = d − Vᵀforces. places: of the parts of a d that is there already; no weights are asked for then, and whole is
    empty.
    """
    numbers, forced, rest = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    buffer = np.empty((where.shape[1], _APART), whole.dtype)
    chosen, chosen_forces = _choose(weights), _choose(forces)
    is_given, pairs, at = len(places) > 0, more.any(), whole.ctypes.data
    is_forced = not is_given and not pairs and (weights == forces).all()  # d is this sum itself: nothing is left of it
    for leaf in range(len(where)):
        if is_given:
            at = places[leaf, 0]
        size = places[leaf, 3] if is_given else whole.itemsize
        for start in range(0, where[leaf, 0, 2], _BLOCK):
            width = min(_BLOCK, where[leaf, 0, 2] - start)
            d = block.numbers_at(at, width, numbers) if size == numbers.itemsize else numbers[:width]
            _gather(where[leaf], start, width, buffer)
            if not is_given and pairs:
                _combine_block_in_pairs(d, rest[:width], weights, more, where[leaf], start, buffer)
            elif not is_given:
                _combine_block(d, chosen, where[leaf], start, buffer)
            elif size != numbers.itemsize:
                _widen(at, whole, d)
            if is_forced:
                _measure_block(d, d, where[leaf], start, buffer, sums)
            else:
                _combine_block(forced[:width], chosen_forces, where[leaf], start, buffer)
                _measure_block(d, forced[:width], where[leaf], start, buffer, sums)
            if not is_given and size != numbers.itemsize:
                _narrow(d, at, whole)
            at += width * size
