"""Lengths of vectors and unit rows, by the largest entry first: 1e±170 neither over- nor underflows."""

import math
from dataclasses import dataclass

import numpy as np

from .arrays import Float, Jacobian, Mask, Multipliers

# Squares that neither over- nor underflow, nor lose digits as subnormal numbers where 1e28 of them are added up; and
# the lengths of which they are. What lies beyond is divided by its largest entry first, which costs time and no digit.
_SAFE_SQUARES = (1e-280, 1e280)
_SAFE_LENGTHS = (1e-140, 1e140)


@dataclass(frozen=True, eq=False)
class UnitRows:
    """Ĵᵢ = Jᵢ/‖Jᵢ‖ and the lengths ‖Jᵢ‖ = largest · relative, kept as two factors so that neither overflows.

    jacobian: (m, n), rows of length 1, or 0 where Jᵢ = 0; largest: about max |Jᵢⱼ|, 0 where Jᵢ = 0; relative: the rest.
    """

    jacobian: Jacobian
    largest: Multipliers
    relative: Multipliers

    def per_length(self, values: Float[np.ndarray, "*k m"]) -> Float[np.ndarray, "*k m"]:
        """valuesᵢ / ‖Jᵢ‖; on zero rows ±inf with the sign of the value, 0 stays 0."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            quotient = values / self.largest / self.relative
        return np.where(values == 0, 0.0, quotient)

    def times_length(self, values: Multipliers, scale: float = 1.0) -> Multipliers:
        """valuesᵢ · ‖Jᵢ‖ / scale, the division first."""
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            ratio = self.largest / scale
            product = values * ratio * self.relative
            leaves = (values != 0) & ~((ratio > 1e-300) & (ratio < 1e300))
            if leaves.any():  # 1e155 over 1e-155, which a tiny value makes 1 again
                product = np.where(leaves, values / scale * self.largest * self.relative, product)
        return np.where(values == 0, 0.0, product)


def unit_rows(jacobian: Jacobian) -> UnitRows:
    """Ĵ with unit rows: scaled by the largest entry first, so that rows of 1e±170 neither over- nor underflow."""
    norms = lengths(jacobian)
    if norms.size > 0 and norms.min() > _SAFE_LENGTHS[0] and norms.max() < _SAFE_LENGTHS[1]:
        return UnitRows(jacobian / norms[:, None], norms, np.ones(len(norms)))
    rows, largest, relative = _largest_first(jacobian)
    return UnitRows(rows / relative[:, None], largest, relative)


def lengths(vectors: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch"]:
    """‖v‖₂ along the last axis, by the largest entry first: 1e±170 neither over- nor underflows.

    Bit for bit the same whatever vectors stand beside v: a run's numbers may not depend on other runs.
    """
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        squares = np.asarray(np.vecdot(vectors, vectors))
    if squares.size > 0 and squares.min() > _SAFE_SQUARES[0] and squares.max() < _SAFE_SQUARES[1]:
        return np.asarray(np.sqrt(squares))
    _, largest, relative = _largest_first(vectors)
    safe = (squares > _SAFE_SQUARES[0]) & (squares < _SAFE_SQUARES[1])
    with np.errstate(over="ignore"):  # infinite beyond 1.8e308: callers refuse it
        return np.asarray(np.where(safe, np.sqrt(squares), largest * relative))


def resolve_overflow(sums: np.ndarray, start: np.ndarray, rows: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """startᵢ + Jᵢ · v, (…, m), in smaller units where a sum came out NaN or infinite: terms beyond 1e308 may cancel."""
    lost = ~np.isfinite(sums)
    if not lost.any():
        return sums
    e, f = np.frexp(np.abs(rows).max(axis=-1))[1], np.frexp(np.abs(vector).max(axis=-1, keepdims=True))[1]
    with np.errstate(over="ignore", under="ignore"):
        products = np.vecdot(np.ldexp(rows, -e[..., None]), np.ldexp(vector, -f)[..., None, :])
        return np.where(lost, np.ldexp(np.ldexp(start, -e - f) + products, e + f), sums)


def demand(values: Float[np.ndarray, "*k m"], equality: Mask) -> Float[np.ndarray, "*k m"]:
    """vᵢ on I, |vᵢ| on E: what bounds ask for, and what is lacking of them, where it is positive."""
    return np.where(equality, np.abs(values), values)


def norm(vector: np.ndarray) -> float:
    """‖v‖₂, without the overhead of `lengths` where the square neither over- nor underflows."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        square = float(vector @ vector)
    return math.sqrt(square) if _SAFE_SQUARES[0] < square < _SAFE_SQUARES[1] else float(lengths(vector))


def _largest_first(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """v/max|v|, max|v| and ‖v/max|v|‖ along the last axis; v, 0 and 1 where v = 0."""
    largest = np.abs(vectors).max(axis=-1, initial=0.0)
    scaled = vectors / np.where(largest > 0, largest, 1.0)[..., None]
    relative = np.where(largest > 0, np.sqrt(np.vecdot(scaled, scaled)), 1.0)
    return scaled, np.asarray(largest), np.asarray(relative)
