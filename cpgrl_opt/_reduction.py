"""Compiled loops of `reduction` in float64: twenty numbers are too few for NumPy. Importing this imports numba."""

from functools import partial
from math import frexp, sqrt
from typing import Any

import numpy as np

from .machine_code import compiled

_VECTOR, _MATRIX, _INTEGERS = "f8[::1]", "f8[:, ::1]", "i8[::1]"
_READ = "Array(f8, {}, 'C', readonly=True)"


def _entry(*signature: str, returns: str = "void") -> Any:
    return partial(compiled, f"{returns}({', '.join(signature)})")


@_entry(_READ.format(2), "Array(b1, 1, 'C', readonly=True)", "f8", "f8", _VECTOR, _VECTOR, returns="boolean")
def measure(K: Any, on: Any, least: float, most: float, scales: Any, lengths: Any) -> bool:
    """Lengths of g and of the rows that are on, 0 for the others, and the powers of two just above them.

    False where a square is neither 0 nor between the bounds, which NaN is not.
    """
    for i in range(K.shape[0]):
        scales[i], lengths[i] = 1.0, 0.0
        if (i == 0 or on[i - 1]) and K[i, i] != 0.0:
            if not least < K[i, i] < most:
                return False
            lengths[i] = sqrt(K[i, i])
            scales[i] = np.ldexp(1.0, frexp(lengths[i])[1])
    return True


@_entry(_READ.format(2), _READ.format(1), _READ.format(1), "f8", "f8", _MATRIX, _INTEGERS, returns="i8")
def factorize(K: Any, scales: Any, lengths: Any, apart: float, out_of_span: float, L: Any, basis: Any) -> int:
    """L of the scaled rows, in their order, and then of g; returns how many rows there are.

    −1 where ‖L⁻¹‖_F² of the unit rows exceeds `apart`, or g's pivot is below `out_of_span` of g·g.
    """
    count, rank = K.shape[0], 0
    L[:] = 0.0
    total, inverse = 0.0, np.zeros((count, count))
    for step in range(1, count + 1):
        i = step if step < count else 0
        if lengths[i] == 0.0:
            continue
        pivot = K[i, i] / (scales[i] * scales[i])
        square = pivot
        for k in range(rank):
            s = K[i, basis[k]] / (scales[i] * scales[basis[k]])
            for j in range(k):
                s -= L[i, j] * L[basis[k], j]
            L[i, k] = s / L[basis[k], k]
            pivot -= L[i, k] * L[i, k]
        if i == 0:
            if not pivot >= out_of_span * square:
                return -1
            L[0, rank] = sqrt(pivot)
        else:
            if not pivot * apart >= square:  # it alone would exceed the bound
                return -1
            L[i, rank] = sqrt(pivot)
            basis[rank] = i
            inverse[rank, rank] = 1.0 / L[i, rank]
            for c in range(rank):
                s = 0.0
                for j in range(c, rank):
                    s -= L[i, j] * inverse[j, c]
                inverse[rank, c] = s / L[i, rank]
            for c in range(rank + 1):
                unit = inverse[rank, c] * lengths[basis[c]] / scales[basis[c]]
                total += unit * unit
            if not total <= apart:
                return -1
            rank += 1
    return rank


@_entry(_READ.format(2), _READ.format(1), _READ.format(1), "i8", _INTEGERS, _READ.format(1), _VECTOR)
def substitute(L: Any, gradient: Any, scales: Any, rank: int, basis: Any, x: Any, weights: Any) -> None:
    """(a, w) with a g + Jᵀw = Qᵀx; gradient: g's own coordinates."""
    weights[:] = 0.0
    if gradient[rank] != 0.0:
        weights[0] = x[rank] / gradient[rank]
    rest = np.empty(rank)
    for k in range(rank):
        rest[k] = x[k] - weights[0] * gradient[k]
    for j in range(rank - 1, -1, -1):
        row = basis[j]
        w = rest[j] / L[row, j]
        for k in range(j):
            rest[k] -= w * L[row, k]
        weights[row] = w / scales[row]
