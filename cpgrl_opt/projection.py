"""The paper's P, d and λ as pure functions of the constraint gradients.

Rows are scaled to unit length before the rank is decided, so that scaling a row changes nothing: a pseudo-inverse
of the raw Gram matrix silently drops a row that is 1e-6 of the others.
"""

from dataclasses import dataclass

import numpy as np

from .arrays import ArrayLike, Jacobian, Multipliers, Vector
from .problem import UnitRows, unit_rows
from .validation import finite_array, require_shape

# Between rounding (1e-15) and rows that are 1e-9 rad apart, which still count as two.
RANK_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class _RowSpace:
    """Thin singular value decomposition Ĵ = U diag(s) Vᵀ cut at the numerical rank r; left (m, r), right (n, r)."""

    rows: UnitRows
    left: np.ndarray
    singular_values: np.ndarray
    right: np.ndarray

    def least_norm(self, target: np.ndarray) -> np.ndarray:
        """Ĵ⁺ target."""
        return np.asarray(self.right @ ((self.left.T @ target) / self.singular_values))

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
    return space.least_norm(np.where(space.rows.largest > 0, space.rows.per_length(target), 0.0))


def tangent_multipliers(jacobian: ArrayLike, gradient: ArrayLike) -> Multipliers:
    """λ = (J Jᵀ)⁻¹ J Δ, the least-norm one (on unit rows) if rows depend; ≤ 0 at a constrained optimum.

    (m, n), (n,) → (m,). The multiplier of the inequality Jd ≥ 0 is −λ. Source: eq. 7.
    """
    space, g = _row_space(jacobian), finite_array("gradient", gradient, 1)
    require_shape("gradient", g, (space.right.shape[0],))
    weights = space.left @ ((space.right.T @ g) / space.singular_values)
    return np.where(space.rows.largest > 0, space.rows.per_length(weights), 0.0)


def projection_matrix(jacobian: ArrayLike) -> np.ndarray:
    """P = I − N (NᵀN)⁻¹ Nᵀ with N = Jᵀ, (n, n): symmetric, idempotent, JP = 0. Source: eq. 9."""
    V = _row_space(jacobian).right
    return np.asarray(np.eye(len(V)) - V @ V.T)


def _row_space(jacobian: ArrayLike) -> _RowSpace:
    J: Jacobian = finite_array("jacobian", jacobian, 2)
    rows = unit_rows(J)
    left, singular_values, right = np.linalg.svd(rows.jacobian, full_matrices=False)
    rank = int((singular_values > RANK_TOLERANCE * max(singular_values.max(initial=0.0), 1.0)).sum())
    return _RowSpace(rows, left[:, :rank], singular_values[:rank], right[:rank].T)
