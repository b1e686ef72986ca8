"""One step of polishing, ours: the projection of g onto the face that a back end found, with its multipliers.

    d = argmin ½‖d − g‖²  s.t.  Ĵᵢd = b̂ᵢ (i ∈ 𝒜),      Ĵᵀμ = d − g,  μᵢ ≥ 0 (i ∈ 𝒜 ∩ I),  μᵢ = 0 (i ∉ 𝒜)

A first-order method finds 𝒜 long before it finds twelve digits of d. The rows of 𝒜 are orthonormalised (pivoted QR),
so that d keeps all its digits where g + Jᵀμ would cancel. Source: Stellato et al. 2020, OSQP, §5.3 (the idea).
"""

import numpy as np
from jaxtyping import Bool, Float

from ..arrays import Vector
from ..projection import RANK_TOLERANCE
from .reduction import ScaledProblem

# A row within this of its bound, in units of s, may belong to the face whatever multiplier a back end reports.
_NEARLY_TIGHT = 1e-6


def faces(scaled: ScaledProblem, d: Vector, multipliers: Float[np.ndarray, "p"]) -> list[Bool[np.ndarray, "p"]]:
    """Candidates for 𝒜, the likeliest first: rows whose multiplier outweighs their slack; rows that are tight."""
    slack = scaled.rows @ d - scaled.bound
    outweighing = scaled.equality | (multipliers > np.maximum(slack, 0.0))
    tight = scaled.equality | (slack <= _NEARLY_TIGHT * max(1.0, float(np.abs(d).max())))
    return [outweighing] if (outweighing == tight).all() else [outweighing, tight]


def project_onto_face(
    scaled: ScaledProblem, face: Bool[np.ndarray, "p"], *, nonnegative: bool = True
) -> tuple[Vector, Float[np.ndarray, "p"]]:
    """(d, μ) of the module's head for 𝒜 = face, in units of s; μᵢ < 0 where no better ones exist.

    nonnegative=False: whatever sign the independent rows give, for rules that look at it.
    """
    from scipy.linalg import qr, solve_triangular

    rows, bound, g = scaled.rows[face], scaled.bound[face], scaled.gradient
    multipliers = np.zeros(len(face))
    if len(rows) == 0:
        return g.copy(), multipliers
    Q, R, order = qr(rows.T, mode="economic", pivoting=True, check_finite=False)
    rank = int((np.abs(R.diagonal()) > RANK_TOLERANCE).sum())
    Q, R, chosen = Q[:, :rank], R[:rank, :rank], order[:rank]
    offset = solve_triangular(R, bound[chosen], trans="T", check_finite=False)
    d = _off(Q, g) + Q @ offset
    weights = np.zeros(len(rows))
    weights[chosen] = solve_triangular(R, Q.T @ (d - g), check_finite=False)
    if nonnegative and rank < len(rows) and (weights[~scaled.equality[face]] < 0.0).any():
        weights = _nonnegative_weights(Q.T @ rows.T, Q.T @ (d - g), scaled.equality[face])
    else:  # one step of refinement: nearly opposing rows have multipliers of 1e9
        weights[chosen] += solve_triangular(R, Q.T @ (d - g - weights @ rows), check_finite=False)
    multipliers[face] = weights
    return d, multipliers


def _off(Q: Float[np.ndarray, "n k"], g: Vector) -> Vector:
    """(I − QQᵀ) g, twice: the second pass takes away what rounding left of the first."""
    for _ in range(2):
        g = g - Q @ (Q.T @ g)
    return g


def _nonnegative_weights(
    columns: Float[np.ndarray, "k p"], target: Float[np.ndarray, "k"], equality: Bool[np.ndarray, "p"]
) -> Float[np.ndarray, "p"]:
    """argmin ‖columns μ − target‖ with μ ≥ 0 on I, free on E: dependent rows have many multipliers, few with signs."""
    from scipy.optimize import nnls

    weights = np.zeros(columns.shape[1])
    try:
        parts, _ = nnls(np.hstack([columns, -columns[:, equality]]), target)
    except RuntimeError:  # its iteration limit; the back end's own multipliers stand
        return weights
    weights += parts[: columns.shape[1]]
    weights[equality] -= parts[columns.shape[1] :]
    return weights
