"""The paper's P, d and λ as pure functions of the constraint gradients.

Rows are scaled to unit length before the rank is decided, so that scaling a row changes nothing: a pseudo-inverse
of the raw Gram matrix silently drops a row that is 1e-6 of the others.
"""

from dataclasses import dataclass

import numpy as np

from .arrays import ArrayLike, Bool, Float, Multipliers, Vector
from .scaling import UnitRows, unit_rows
from .validation import finite_array, require_shape

# Between rounding (1e-15) and rows that are 1e-9 rad apart, which still count as two.
RANK_TOLERANCE = 1e-12
# Multipliers of unit rows that differ by less tie, in units of the largest and of ‖Δ‖: far above what rounding makes of
# equal ones, and too little for the wrong one of two nearly opposing rows, λ̂ = 1e10 both, to leave with the right one.
_TIED = 1e-9


@dataclass(frozen=True, eq=False)
class _RowSpace:
    """Thin singular value decomposition Ĵ = U diag(s) Vᵀ cut at the numerical rank r; left (m, r), right (n, r)."""

    rows: UnitRows
    left: np.ndarray
    singular_values: np.ndarray
    right: np.ndarray

    def off(self, vector: np.ndarray) -> np.ndarray:
        """(I − V Vᵀ) vector, twice: the second pass takes away what rounding left of the first."""
        for _ in range(2):
            vector = vector - self.right @ (self.right.T @ vector)
        return vector


def project_onto_tangent(jacobian: ArrayLike, gradient: ArrayLike) -> Vector:
    """PΔ = Δ − J⁺JΔ, the part of the gradient tangent to all constraints; (m, n), (n,) → (n,). Source: eq. 9."""
    space, g = _row_space(jacobian), finite_array("gradient", gradient, 1)
    require_shape("gradient", g, (space.right.shape[0],))
    return space.off(g)


def restoration_move(jacobian: ArrayLike, slack: ArrayLike) -> Vector:
    """d = J⁺ slack, to be subtracted: J(θ − d) makes up for a negative slack; (m, n), (m,) → (n,). Source: eq. 10."""
    space, target = _row_space(jacobian), finite_array("slack", slack, 1)
    require_shape("slack", target, space.rows.largest.shape)
    target = np.where(space.rows.largest > 0, space.rows.per_length(target), 0.0)
    return np.asarray(space.right @ ((space.left.T @ target) / space.singular_values))


def tangent_multipliers(jacobian: ArrayLike, gradient: ArrayLike) -> Multipliers:
    """λ = (J Jᵀ)⁻¹ J Δ, the least-norm one (on unit rows) if rows depend; ≤ 0 at a constrained optimum.

    (m, n), (n,) → (m,). The multiplier of the inequality Jd ≥ 0 is −λ. Source: eq. 7.
    """
    space, g = _row_space(jacobian), finite_array("gradient", gradient, 1)
    require_shape("gradient", g, (space.right.shape[0],))
    weights = space.left @ ((space.right.T @ g) / space.singular_values)
    return np.where(space.rows.largest > 0, space.rows.per_length(weights), 0.0)


def unit_multipliers(
    unit_jacobian: Float[np.ndarray, "B m n"], gradient: Float[np.ndarray, "B n"]
) -> Float[np.ndarray, "B m"]:
    """λ̂ᵢ = λᵢ‖Jᵢ‖ of the same λ for B problems at once, from rows of length 1, or 0 where a row is left out."""
    left, singular_values, right = np.linalg.svd(unit_jacobian, full_matrices=False)
    largest = singular_values.max(axis=1, initial=1.0, keepdims=True)
    counts = singular_values > RANK_TOLERANCE * largest
    inverse = np.where(counts, 1.0 / np.where(counts, singular_values, 1.0), 0.0)
    return np.asarray(((left * inverse[:, None, :]) @ (right @ gradient[:, :, None]))[:, :, 0])


def largest_multipliers(
    multipliers: Float[np.ndarray, "B m"], unit_multipliers: Float[np.ndarray, "B m"], among: Bool[np.ndarray, "B m"]
) -> Bool[np.ndarray, "B m"]:
    """Where λᵢ is the largest `among` some, or ties with it: a row and its copy do, and order must not tell them apart.

    unit_multipliers: λ̂ᵢ in units of ‖Δ‖.
    """
    compared = np.where(among, multipliers, -np.inf)
    leader = compared.argmax(axis=1)[:, None]
    relative = _TIED / np.maximum(1.0, np.take_along_axis(unit_multipliers, leader, axis=1))
    return np.asarray(among & (compared >= (1.0 - relative) * np.take_along_axis(compared, leader, axis=1)))


def projection_matrix(jacobian: ArrayLike) -> np.ndarray:
    """P = I − N (NᵀN)⁻¹ Nᵀ with N = Jᵀ, (n, n): symmetric, idempotent, JP = 0. Source: eq. 9."""
    V = _row_space(jacobian).right
    return np.asarray(np.eye(len(V)) - V @ V.T)


def _row_space(jacobian: ArrayLike) -> _RowSpace:
    rows = unit_rows(finite_array("jacobian", jacobian, 2))
    left, singular_values, right = np.linalg.svd(rows.jacobian, full_matrices=False)
    rank = int((singular_values > RANK_TOLERANCE * max(singular_values.max(initial=0.0), 1.0)).sum())
    return _RowSpace(rows, left[:, :rank], singular_values[:rank], right[:rank].T)
