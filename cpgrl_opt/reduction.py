"""Coordinates in the span of g and the rows of J, found from their inner products alone.

    K = V Vᵀ = L Lᵀ,   V = L Q = [rows; g],   Q orthonormal and never formed       L lower triangular, k ≤ 1 + m columns

A direction in the span is d = Qᵀx. So min ½‖d − g‖² s.t. J d ≥ b is the same problem in x, with the rows of L for those
of V; and d = a g + Jᵀw with Lᵀ(w, a) = x, the only other place where the vectors are met.

There are two rungs. "gramian": L in float64, where the rows that are on are well apart, ‖L⁻¹‖_F² ≤ 1e4 for unit rows,
and g is not nearly in their span. "pairs": K, L and w with 106 bits, for all else. Rows at an angle θ from opposing
lose 2⁻¹⁰⁰/θ² of K, so that L is exact to rounding down to θ = 1e-7. Whoever solves the problem sees L in float64, which
tilts such rows by eps/θ; his answer is mended by the equations of its active rows, in pairs:

    K_A w = b_A,   w = (1, μ),   μ = 0 off A                     A: the rows with μ ≠ 0
Source: Golub & Van Loan, Matrix Computations, §4.2 and §5.3; with pivoting: Higham 2002, §10.3.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import Bool, Float, Int
from .compensated import Pair
from .vectors import Certificate, Vectors

RUNGS = ("gramian", "pairs")
EXACT = 1e-12  # what the first rung adds to an answer at the most where its gates are open
# Rung 1 loses ‖L⁻¹‖² eps of an answer: 1e-12 here. With 1e8 rows 1e-4 rad from opposing would be off by 1e-8, which
# the certificate finds a pass too late.
_APART = 1e4
# g's squared distance from the rows' span, over g·g: PΔ¹ has no digit left where it is eps.
OUT_OF_SPAN = 1e-8
# Rung 2: a row depends on others where no more of its square is left: 1e-13 of its length, as in the exact solver. K in
# pairs leaves 2⁻¹⁰⁰ or so of exact dependence, and of g 2⁻⁹⁷/√p after a pivot p.
_RANK, _ROUNDING = 1e-26, 2.0**-97
# Rung 2 loses 2⁻¹⁰⁰ ‖L⁻¹‖_F² of an answer: 1e-12 here, with rows 3e-9 rad from opposing. At 1e-11 rad answers were off
# by 1e-8, at 1e-13 by a quarter, and no referee sees it: rows so close hardly tell one direction from the other.
_CLEAR = 1e-18
# Of a kind without pairs K in float64 has to do, which leaves 1e-14 or so of exact dependence: rows either depend, or
# stand as clear as on rung 1. With 1e-15 rounding would count as a row of its own; a row that is within 1e-6 rad of the
# others and counts as dependent is off by as much, which the certificate sees.
_ROUGH_RANK = 1e-12
# Where L of the rows that are named has no larger singular value, rows depend: 1e-9 where they stand clear, or eps.
_DEPENDENT = 1e-12
# Squared lengths beyond these leave float64, or lose digits as subnormal numbers.
_LEAST, _MOST = 1e-280, 1e280
GATES = _LEAST, _MOST, _APART  # of rung 1, for compiled code


# What leaves float64 on the way is found at the end: no warning, whatever the caller's `np.errstate`.
_silent = np.errstate(all="ignore")


@dataclass(frozen=True, eq=False)
class Coordinates:
    """g and J in the coordinates of Q: gradient (k,), jacobian (m, k), k = 1 + m; rows that are off are 0.

    scales: (1 + m,) powers of two, g's first, that leave the vectors ½ to 1 long; lengths: (1 + m,) of the vectors, 0
    where they are off; factor: L of the scaled vectors, (1 + m, k), in the order of g and the rows; basis: the rows
    that span, in the order of their columns; rung: which of RUNGS; gramian: K of the scaled vectors.
    """

    gradient: Float[np.ndarray, "k"]
    jacobian: Float[np.ndarray, "m k"]
    scales: Float[np.ndarray, "channels"]
    lengths: Float[np.ndarray, "channels"]
    factor: Pair
    basis: Int[np.ndarray, "part"]
    rung: str
    gramian: Pair

    @_silent
    def weights(self, x: Float[np.ndarray, "k"]) -> Pair:
        """(a, w) with a g + Jᵀw = Qᵀx, (1 + m,); a = 1 exactly where x keeps g's part outside the span of the rows."""
        weights, rank = _zeros(self.scales.shape), len(self.basis)
        outside = self.gradient[rank]
        a = float(x[rank] / outside) if outside != 0.0 else 0.0
        if self.rung == "gramian":
            L = self.factor.hi[self.basis, :rank]
            weights.hi[self.basis] = np.linalg.solve(L.T, x[:rank] - a * self.gradient[:rank]) / self.scales[self.basis]
            weights.hi[0] = a
            return weights
        own = self.factor.at(0, slice(rank)).times(self.scales[0])
        w = _solve_transposed(self.factor.at(self.basis, slice(rank)), _pair(x[:rank]).plus(own.times(-a)))
        weights.put(self.basis, w, 1.0 / self.scales[self.basis])
        weights.hi[0] = a
        return weights

    @_silent
    def refine(self, multipliers: Float[np.ndarray, "m"], bound: Float[np.ndarray, "m"]) -> Pair:
        """w = (1, μ) of the d on the face that the multipliers name, J_A d = b_A; by iterative refinement.

        Each round leaves eps/θ of the error, at 1e-8 rad too: after three it is that of K.
        """
        named, weights = 1 + np.flatnonzero(multipliers), _zeros(self.scales.shape)
        weights.hi[0] = 1.0
        if not named.size:
            return weights
        U, S, _ = np.linalg.svd(self.factor.rounded()[named], full_matrices=False)
        U, S = U[:, S > _DEPENDENT], S[S > _DEPENDENT]
        K, scales, unit = self.gramian.at(*np.ix_(named, named)), self.scales[named], self.scales[0]
        target = _pair(bound[named - 1] / scales / unit).plus(self.gramian.at(named, 0).times(-1.0))
        w = _pair(multipliers[named - 1] * (scales / unit))
        for _ in range(3):
            left = target.plus(K.times_pair(w.negate()).sums()).rounded()
            w = w.plus(_pair(U @ (U.T @ left / S / S)))
        weights.put(named, w, unit / scales)
        return weights

    @_silent
    def holds(self, x: Float[np.ndarray, "k"], certificate: Certificate, unit: float) -> bool:
        """Whether J d and ‖d‖ of the vectors' own d are those of x to 1e-12 unit: what x proves, d proves too."""
        on = self.lengths[1:] > 0.0
        apart = np.abs(certificate.products - self.jacobian @ x)[on] / self.lengths[1:][on]
        length = abs(certificate.length - float(np.linalg.norm(x)))
        return bool(max(apart.max(initial=0.0), length) <= EXACT * unit)


@_silent
def coordinates(vectors: Vectors, on: Bool[np.ndarray, "m"], rung: str, *, clear: float = _CLEAR) -> Coordinates | None:
    """Of g and the rows that are on; None where the rung is not exact enough, or a square leaves float64.

    clear: the least 1/‖L⁻¹‖_F² that "pairs" takes, L of rows that do not depend on each other.
    """
    is_rough = rung == "gramian" or not vectors.has_pairs
    K = _pair(vectors.gramian().copy()) if is_rough else vectors.gramian_in_pairs()
    squares = np.where(np.append(True, on), K.hi.diagonal(), 0.0)
    if not ((squares == 0.0) | ((squares > _LEAST) & (squares < _MOST))).all():  # which NaN is not
        return None
    lengths = np.sqrt(squares)
    scales = np.where(lengths > 0.0, np.ldexp(1.0, np.frexp(lengths)[1]), 1.0)
    off = np.flatnonzero(lengths == 0.0)
    K.hi[off], K.hi[:, off], K.lo[off], K.lo[:, off] = 0.0, 0.0, 0.0, 0.0
    for i in off.tolist():
        if (i == 0 or on[i - 1]) and not vectors.is_zero(i):
            return None
    if rung == "gramian":
        found = _factor(K, scales, lengths)
    else:
        exponents = np.frexp(0.5 * scales)[1]
        K = Pair(*(np.ldexp(part, -exponents - exponents[:, None]) for part in K))
        found = _factor_in_pairs(K, lengths, *((1.0 / _APART, _ROUGH_RANK) if is_rough else (clear, _RANK)))
    if found is None:
        return None
    factor, basis = found
    L = scales[:, None] * factor.rounded()
    return Coordinates(L[0], L[1:], scales, lengths, factor, basis, rung, K)


def _factor(K: Pair, scales: np.ndarray, lengths: np.ndarray) -> tuple[Pair, np.ndarray] | None:
    """L of the rows and then g, in float64; None where the gates of rung 1 are shut."""
    basis = 1 + np.flatnonzero(lengths[1:])
    order = np.append(basis, 0) if lengths[0] > 0.0 else basis
    rank, A = len(basis), K.hi[np.ix_(order, order)] / (scales[order] * scales[order, None])
    try:
        C = np.linalg.cholesky(A)
    except np.linalg.LinAlgError:
        return None
    inverse = np.linalg.inv(C[:rank, :rank]) * (lengths / scales)[basis]
    if not np.square(inverse).sum() <= _APART:
        return None
    if len(order) > rank and not C[rank, rank] ** 2 >= OUT_OF_SPAN * A[rank, rank]:
        return None
    L = np.zeros(K.hi.shape)
    L[order, : len(order)] = C
    return Pair(L, K.lo), basis


def _factor_in_pairs(K: Pair, lengths: np.ndarray, clear: float, least: float) -> tuple[Pair, np.ndarray] | None:
    """L of the rows, the farthest from the span so far first, and then g; and the rows that span.

    None where a row neither depends on the others nor stands clear of them, or ‖L⁻¹‖_F² exceeds 1/clear.
    """
    rows = [i for i in range(1, len(lengths)) if lengths[i] > 0.0]
    left, basis, factor, smallest = list(rows), list[int](), _zeros(K.hi.shape), 1.0
    while left:
        row = left[int(np.argmax(K.hi[left, left]))]
        if not K.hi[row, row] > least:
            break
        smallest = min(smallest, K.hi[row, row])
        K = _eliminate(K, row, factor, len(basis))
        left.remove(row)
        basis.append(row)
    L = factor.rounded()[basis, : len(basis)]
    if not np.square(np.linalg.inv(L)).sum() <= 1.0 / clear:  # what no pivot shows of many rows: Kahan's, for one
        return None
    if K.hi[0, 0] > max(least, _ROUNDING / np.sqrt(smallest)):
        _eliminate(K, 0, factor, len(basis))
    for part in factor:  # what rounding leaves of 0
        for k in range(len(basis)):
            part[basis[:k], k] = 0.0
        part[rows, len(basis) :] = 0.0
    return factor, np.array(basis, np.int64)


def _eliminate(K: Pair, row: int, factor: Pair, k: int) -> Pair:
    """Column k of L from the row of K, and what it leaves of K."""
    column = K.at(slice(None), row).over(K.at(row, row).root())
    factor.put((slice(None), k), column)
    across, down = column.at(None), column.at(slice(None), None)
    return K.plus(down.times_pair(across.negate()))


def _solve_transposed(L: Pair, x: Pair) -> Pair:
    """L⁻ᵀx by back substitution."""
    w = Pair(x.hi.copy(), x.lo.copy())
    for j in range(len(w.hi) - 1, -1, -1):
        found = w.at(j).over(L.at(j, j))
        w.put(j, found)
        w.put(slice(j), w.at(slice(j)).plus(L.at(j, slice(j)).times_pair(found.negate())))
    return w


def _pair(hi: np.ndarray) -> Pair:
    return Pair(hi, np.zeros_like(hi))


def _zeros(shape: tuple[Any, ...]) -> Pair:
    return Pair(np.zeros(shape), np.zeros(shape))
