"""The paper's P, d and λ as pure functions of the constraint gradients.

Rows are scaled to unit length before the rank is decided, so that scaling a row changes nothing: a pseudo-inverse
of the raw Gram matrix silently drops a row that is 1e-6 of the others.
"""

import numpy as np

from .arrays import ArrayLike, Bool, Float, Multipliers, Vector
from .scaling import UnitRows, unit_rows
from .validation import finite_array, require_shape

# Between rounding (1e-15) and rows that are 1e-9 rad apart, which still count as two.
RANK_TOLERANCE = 1e-12
# Multipliers of unit rows that differ by less tie, in units of the largest and of ‖Δ‖: far above what rounding makes of
# equal ones, and too little for the wrong one of two nearly opposing rows, λ̂ = 1e10 both, to leave with the right one.
_TIED = 1e-9


def project_onto_tangent(jacobian: ArrayLike, gradient: ArrayLike) -> Vector:
    """PΔ = Δ − J⁺JΔ, the part of the gradient tangent to all constraints. Source: eq. 9.

    Parameters
    ----------
    jacobian
        J, (m, n); rows may depend or be zero
    gradient
        Δ, (n,)

    Returns
    -------
    array
        PΔ, (n,), in the unit of Δ

    Raises
    ------
    ValueError
        An array that is not finite, or of another shape.
    """
    _, (_, _, V), g = _factors_beside(jacobian, "gradient", gradient, 1)
    for _ in range(2):  # the second pass takes away what rounding left of the first
        g = g - V @ (V.T @ g)
    return g


def restoration_move(jacobian: ArrayLike, slack: ArrayLike) -> Vector:
    """d = J⁺ slack, to be subtracted: J(θ − d) makes up for a negative slack. Source: eq. 10.

    Parameters
    ----------
    jacobian
        J, (m, n); a zero row is left out
    slack
        (m,), in the unit of the constraints

    Returns
    -------
    array
        d, (n,), in the unit of θ; the shortest one

    Raises
    ------
    ValueError
        An array that is not finite, or of another shape.
    """
    rows, (U, s, V), target = _factors_beside(jacobian, "slack", slack, 0)
    target = np.where(rows.largest > 0, rows.per_length(target), 0.0)
    return np.asarray(V @ ((U.T @ target) / s))


def tangent_multipliers(jacobian: ArrayLike, gradient: ArrayLike) -> Multipliers:
    """λ = (J Jᵀ)⁻¹ J Δ, the least-norm one (on unit rows) if rows depend; ≤ 0 at a constrained optimum.

    The multiplier of the inequality Jd ≥ 0 is −λ. Source: eq. 7.

    Parameters
    ----------
    jacobian
        J, (m, n); rows may depend or be zero
    gradient
        Δ, (n,)

    Returns
    -------
    array
        λ, (m,), in the unit of Δ by that of J's rows; 0 for a zero row

    Raises
    ------
    ValueError
        An array that is not finite, or of another shape.
    """
    rows, (U, s, V), g = _factors_beside(jacobian, "gradient", gradient, 1)
    return np.where(rows.largest > 0, rows.per_length(U @ ((V.T @ g) / s)), 0.0)


def projection_matrix(jacobian: ArrayLike) -> np.ndarray:
    """P = I − N (NᵀN)⁻¹ Nᵀ with N = Jᵀ: symmetric, idempotent, JP = 0. Source: eq. 9.

    Parameters
    ----------
    jacobian
        J, (m, n); rows may depend or be zero

    Returns
    -------
    array
        P, (n, n), without a unit

    Raises
    ------
    ValueError
        J is not finite, or no matrix.
    """
    _, _, V = _factors(unit_rows(finite_array("jacobian", jacobian, 2)))
    return np.asarray(np.eye(len(V)) - V @ V.T)


def _factors_beside(
    jacobian: ArrayLike, name: str, values: ArrayLike, axis: int
) -> tuple[UnitRows, tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """The unit rows of J, their factors, and values that are as long as an axis of J."""
    rows, vector = unit_rows(finite_array("jacobian", jacobian, 2)), finite_array(name, values, 1)
    require_shape(name, vector, rows.jacobian.shape[axis : axis + 1])
    return rows, _factors(rows), vector


def _factors(rows: UnitRows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """U, s and V of Ĵ = U diag(s) Vᵀ, cut at the numerical rank."""
    U, s, Vt = np.linalg.svd(rows.jacobian, full_matrices=False)
    rank = int((s > RANK_TOLERANCE * max(s.max(initial=0.0), 1.0)).sum())
    return U[:, :rank], s[:rank], Vt[:rank].T


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
