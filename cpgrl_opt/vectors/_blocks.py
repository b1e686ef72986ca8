"""Compiled passes over g and the rows of J, block by block; only arrays of other strides are copied, a part at a time.

    gramian              K = V Vᵀ,  V = [g; J]
    gramian_in_pairs     the same with 106 bits: K = hi + lo
    combine              d = Vᵀw;  r = d − g − Jᵀμ;  r·r, J d, d·d
    combine, in pairs    d = Vᵀ(w + w′) summed with 106 bits and rounded once; the same measures
    combine_columns      as combine, where J lies column by column
    measure              the measures of a d that is there already

Row 0 is g, row i is Jᵢ. Results are added to what the arrays hold, so that long vectors may come in chunks. Sums of a
block may be reordered by the compiler, always in the same way, so that an answer repeats; sums in pairs may not.
Source of the pairs: Dekker 1971; Ogita, Rump & Oishi 2005, Algorithms 3.1, 3.3, 5.3. Importing this imports numba.
"""

from functools import partial
from typing import Any

import numpy as np
from numba import njit

from ..machine_code import compiled

_BLOCK = 1024  # six rows of it fit the first-level cache twice
_MOST_SUMS = 2_000_000  # in pairs, 32 MB: many rows get fewer lanes
_LANES = 256  # sums in pairs run side by side in so many lanes, so that the processor's vectors are full
_HALVES = 134217729.0  # 2²⁷ + 1 splits 53 bits in two halves
_VECTOR, _ROWS = "Array(f8, 1, 'C', readonly=True)", "Array(f8, 2, 'C', readonly=True)"


def _reordered(function: Any) -> Any:
    """Compiled with sums in any order, which makes them vector operations; NaN and infinity stay what they are."""
    return njit(fastmath={"reassoc", "contract", "nsz"}, error_model="numpy")(function)


def _plain(function: Any) -> Any:
    """Compiled as it stands."""
    return njit(error_model="numpy")(function)


def _entry(*signature: str) -> Any:
    return partial(compiled, f"void({', '.join(signature)})")


@_plain
def _row(gradient: Any, jacobian: Any, i: int, start: int, end: int) -> Any:
    return gradient[start:end] if i == 0 else jacobian[i - 1, start:end]


@_reordered
def _inner(a: Any, b: Any) -> float:
    total = 0.0
    for t in range(a.shape[0]):
        total += a[t] * b[t]
    return total


@_reordered
def _nine_inner(a: Any, b: Any, c: Any, x: Any, y: Any, z: Any) -> Any:
    """a·x, a·y … c·z: each number loaded serves three products, and nine sums still fit the registers."""
    ax, ay, az, bx, by, bz, cx, cy, cz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for t in range(a.shape[0]):
        p, q, r, u, v, w = a[t], b[t], c[t], x[t], y[t], z[t]
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
        p, q, r = a[t], b[t], c[t]
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
        a += d[t] * x[t]
        b += d[t] * y[t]
        c += d[t] * z[t]
    return a, b, c


@_reordered
def _rest_and_length(d: Any, forced: Any) -> tuple[float, float]:
    rest, length = 0.0, 0.0
    for t in range(d.shape[0]):
        rest += (d[t] - forced[t]) * (d[t] - forced[t])
        length += d[t] * d[t]
    return rest, length


@_reordered
def _add_three(first: Any, second: Any, a: Any, b: Any, c: Any, x: Any, y: Any, z: Any) -> None:
    """first += a₀x + b₀y + c₀z, second += a₁x + b₁y + c₁z: each number loaded serves both."""
    for t in range(first.shape[0]):
        p, q, r = x[t], y[t], z[t]
        first[t] += a[0] * p + b[0] * q + c[0] * r
        second[t] += a[1] * p + b[1] * q + c[1] * r


@_plain
def _chosen(weights: Any, forces: Any) -> Any:
    """Rows of which a weight is not 0, and both weights, (count, 2); filled up to threes with weights of 0."""
    rows, pairs, count = np.zeros(len(weights) + 2, np.int64), np.zeros((len(weights) + 2, 2)), 0
    for i in range(len(weights)):
        if weights[i] != 0.0 or forces[i] != 0.0:
            rows[count], pairs[count, 0], pairs[count, 1] = i, weights[i], forces[i]
            count += 1
    rows[count:] = rows[max(count - 1, 0)]
    return rows, pairs, count


@_plain
def _combine_block(d: Any, forced: Any, chosen: Any, gradient: Any, jacobian: Any, start: int) -> None:
    """d += Σ weightsᵢ rowᵢ, forced += Σ forcesᵢ rowᵢ."""
    rows, pairs, count = chosen
    end = start + d.shape[0]
    for i in range(0, count, 3):
        x = _row(gradient, jacobian, rows[i], start, end)
        y = _row(gradient, jacobian, rows[i + 1], start, end)
        z = _row(gradient, jacobian, rows[i + 2], start, end)
        a, b, c = pairs[i], pairs[i + 1], pairs[i + 2]
        _add_three(d, forced, (a[0], a[1]), (b[0], b[1]), (c[0], c[1]), x, y, z)


@_plain
def _measure_block(d: Any, forced: Any, jacobian: Any, start: int, sums: Any) -> None:
    """sums += [r·r, J d …, d·d] of a block, r = d − forced."""
    m, end = jacobian.shape[0], start + d.shape[0]
    for i in range(0, m, 3):
        x, y = jacobian[i, start:end], jacobian[min(i + 1, m - 1), start:end]
        products = _three_inner(d, x, y, jacobian[min(i + 2, m - 1), start:end])
        for k in range(min(3, m - i)):
            sums[1 + i + k] += products[k]
    rest, length = _rest_and_length(d, forced)
    sums[0] += rest
    sums[1 + m] += length


@_entry(_VECTOR, _ROWS, "f8[:, ::1]")
def gramian(gradient: Any, jacobian: Any, out: Any) -> None:
    """The lower triangle."""
    count, n = 1 + jacobian.shape[0], gradient.shape[0]
    for start in range(0, n, _BLOCK):
        end = min(start + _BLOCK, n)
        for i in range(0, count, 3):
            a = _row(gradient, jacobian, i, start, end)
            b = _row(gradient, jacobian, min(i + 1, count - 1), start, end)
            c = _row(gradient, jacobian, min(i + 2, count - 1), start, end)
            for j in range(0, i + 1, 3):
                if j == i:
                    sums = _six_inner(a, b, c)
                else:
                    x = _row(gradient, jacobian, j, start, end)
                    y = _row(gradient, jacobian, j + 1, start, end)
                    sums = _nine_inner(a, b, c, x, y, _row(gradient, jacobian, j + 2, start, end))
                for k in range(min(3, count - i)):
                    for q in range(min(3, i + k - j + 1)):
                        out[i + k, j + q] += sums[k][q]


@_plain
def _split(x: Any, high: Any, low: Any) -> None:
    for t in range(x.shape[0]):
        scaled = _HALVES * x[t]
        high[t] = scaled - (scaled - x[t])
        low[t] = x[t] - high[t]


@_plain
def _add_products(x: Any, x_high: Any, x_low: Any, y: Any, y_high: Any, y_low: Any, total: Any, rest: Any) -> None:
    """total + rest += x·y, each lane by itself and without rounding, but for what 106 bits do not hold."""
    for t in range(x.shape[0]):
        product = x[t] * y[t]
        error = x_low[t] * y_low[t] - (
            ((product - x_high[t] * y_high[t]) - x_low[t] * y_high[t]) - x_high[t] * y_low[t]
        )
        old = total[t]
        new = old + product
        part = new - old
        rest[t] += error + ((old - (new - part)) + (product - part))
        total[t] = new


@_plain
def _sum_pairs(total: Any, rest: Any) -> tuple[float, float]:
    high, low = 0.0, 0.0
    for t in range(total.shape[0]):
        new = high + total[t]
        part = new - high
        low += rest[t] + ((high - (new - part)) + (total[t] - part))
        high = new
    return high + low, low - ((high + low) - high)


@_entry(_VECTOR, _ROWS, "f8[:, ::1]", "f8[:, ::1]")
def gramian_in_pairs(gradient: Any, jacobian: Any, out: Any, out_low: Any) -> None:
    """The lower triangle as hi + lo, each number of 106 bits; few rows get many lanes, many rows few."""
    count, n = 1 + jacobian.shape[0], gradient.shape[0]
    lanes = max(8, min(_LANES, _MOST_SUMS // (count * count) // 8 * 8))
    high, low = np.empty((count, lanes)), np.empty((count, lanes))
    totals, rests = np.zeros((count, count, lanes)), np.zeros((count, count, lanes))
    for start in range(0, n, lanes):
        end = min(start + lanes, n)
        width = end - start
        for i in range(count):
            x = _row(gradient, jacobian, i, start, end)
            _split(x, high[i, :width], low[i, :width])
            for j in range(i + 1):
                _add_products(
                    x,
                    high[i, :width],
                    low[i, :width],
                    _row(gradient, jacobian, j, start, end),
                    high[j, :width],
                    low[j, :width],
                    totals[i, j, :width],
                    rests[i, j, :width],
                )
    for i in range(count):
        for j in range(i + 1):
            out[i, j], out_low[i, j] = _sum_pairs(totals[i, j], rests[i, j])


@_plain
def _add_multiple(weight: float, more: float, x: Any, high: Any, low: Any, total: Any, rest: Any) -> None:
    """total + rest += (weight + more) x."""
    scaled = _HALVES * weight
    first = scaled - (scaled - weight)
    second = weight - first
    for t in range(x.shape[0]):
        product = weight * x[t]
        error = low[t] * second - (((product - high[t] * first) - low[t] * first) - high[t] * second)
        old = total[t]
        new = old + product
        part = new - old
        rest[t] += (error + more * x[t]) + ((old - (new - part)) + (product - part))
        total[t] = new


@_plain
def _combine_block_in_pairs(
    weights: Any, more: Any, gradient: Any, jacobian: Any, start: int, halves: Any, total: Any, rest: Any
) -> None:
    width = total.shape[0]
    for i in range(weights.shape[0]):
        if weights[i] != 0.0 or more[i] != 0.0:
            x = _row(gradient, jacobian, i, start, start + width)
            _split(x, halves[0, :width], halves[1, :width])
            _add_multiple(weights[i], more[i], x, halves[0, :width], halves[1, :width], total, rest)


@_entry(_VECTOR, _ROWS, _VECTOR, _VECTOR, _VECTOR, "b1", "f8[::1]", "f8[::1]")
def combine(
    gradient: Any, jacobian: Any, weights: Any, more: Any, forces: Any, pairs: bool, out: Any, sums: Any
) -> None:
    """out ← Vᵀ(weights + more), the latter only where pairs; sums += [r·r, J d …, d·d], r = d − Vᵀforces."""
    forced, left, halves = np.empty(_BLOCK), np.empty(_BLOCK), np.empty((2, _BLOCK))
    chosen = _chosen(np.zeros_like(weights) if pairs else weights, forces)
    for start in range(0, gradient.shape[0], _BLOCK):
        d = out[start : min(start + _BLOCK, gradient.shape[0])]
        width = d.shape[0]
        d[:] = 0.0
        forced[:width] = 0.0
        if pairs:
            left[:width] = 0.0
            _combine_block_in_pairs(weights, more, gradient, jacobian, start, halves, d, left[:width])
            for t in range(width):
                d[t] += left[t]
        _combine_block(d, forced[:width], chosen, gradient, jacobian, start)
        _measure_block(d, forced[:width], jacobian, start, sums)


@_entry(_VECTOR, _ROWS, _VECTOR, _VECTOR, "f8[::1]")
def measure(gradient: Any, jacobian: Any, direction: Any, forces: Any, sums: Any) -> None:
    """sums += [r·r, J d …, d·d]."""
    forced, chosen = np.empty(_BLOCK), _chosen(forces, forces)
    unused = np.empty(_BLOCK)
    for start in range(0, gradient.shape[0], _BLOCK):
        d = direction[start : min(start + _BLOCK, gradient.shape[0])]
        width = d.shape[0]
        forced[:width], unused[:width] = 0.0, 0.0
        _combine_block(unused[:width], forced[:width], chosen, gradient, jacobian, start)
        _measure_block(d, forced[:width], jacobian, start, sums)


@_reordered
def _combine_columns_block(
    gradient: Any, columns: Any, weights: Any, forces: Any, start: int, out: Any, sums: Any
) -> None:
    m, rest, length = columns.shape[1], 0.0, 0.0
    products, more, pulls = np.zeros(m), weights[1:], forces[1:]
    for t in range(out.shape[0]):
        column = columns[start + t]
        d, forced = weights[0] * gradient[start + t], forces[0] * gradient[start + t]
        for i in range(m):
            d += more[i] * column[i]
            forced += pulls[i] * column[i]
        for i in range(m):
            products[i] += d * column[i]
        out[t] = d
        rest += (d - forced) * (d - forced)
        length += d * d
    sums[0] += rest
    sums[1 + m] += length
    for i in range(m):
        sums[1 + i] += products[i]


@_entry(_VECTOR, _ROWS, _VECTOR, _VECTOR, "f8[::1]", "f8[::1]")
def combine_columns(gradient: Any, columns: Any, weights: Any, forces: Any, out: Any, sums: Any) -> None:
    """`combine` without pairs, of Jᵀ (n, m): to gather its rows first takes as long again."""
    for start in range(0, gradient.shape[0], _BLOCK):
        d = out[start : min(start + _BLOCK, gradient.shape[0])]
        _combine_columns_block(gradient, columns, weights, forces, start, d, sums)


@_entry("Array(f8, 2, 'A', readonly=True)", "f8[:, ::1]")
def pack(rows: Any, out: Any) -> None:
    """Copies rows of any strides; down the columns where these are contiguous."""
    m, n = rows.shape
    if rows.strides[0] * rows.strides[0] < rows.strides[1] * rows.strides[1]:
        for t in range(n):
            for i in range(m):
                out[i, t] = rows[i, t]
    else:
        for i in range(m):
            for t in range(n):
                out[i, t] = rows[i, t]
