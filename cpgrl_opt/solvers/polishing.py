"""One step of polishing, ours: the projection of g onto the face that a core found, with its multipliers.

    d = argmin ½‖d − g‖²  s.t.  Ĵᵢd = b̂ᵢ (i ∈ 𝒜),      Ĵᵀμ = d − g,  μᵢ ≥ 0 (i ∈ 𝒜 ∩ I),  μᵢ = 0 (i ∉ 𝒜)

A first-order method finds 𝒜 long before it finds twelve digits of d. The rows of 𝒜 are orthonormalised (pivoted QR),
so that d keeps all its digits where g + Jᵀμ would cancel. Source: Stellato et al. 2020, OSQP, §5.3 (the idea).
"""

from collections.abc import Iterator

import numpy as np

from ..arrays import Bool, Float, Vector
from ..projection import RANK_TOLERANCE
from ..scaling import lengths
from .factorization import pivoted_qr, solve_upper
from .small_problem import SmallProblem

# A row this near to its bound, in units of max(‖g‖, ‖d‖), is in the face or not: no core is surer than that.
_NEARLY_TIGHT = 1e-6
_MOST_FACES = 4  # each is a factorization


def polish(
    small: SmallProblem, d: Vector, multipliers: Float[np.ndarray, "p"]
) -> Iterator[tuple[Vector, Float[np.ndarray, "p"]]]:
    """(d, μ) on the face that a core's answer names, then with its undecided rows corrected, a few times.

    A row is active where its multiplier outweighs its slack; undecided where it is nearly tight. Undecided rows
    leave with a negative multiplier and enter when violated.
    """
    slack = small.rows @ d - small.bound
    size = max(float(lengths(d)), float(lengths(small.center)))
    undecided = ~small.equality & (np.abs(slack) <= _NEARLY_TIGHT * size)
    face = small.equality | (multipliers > np.maximum(slack, 0.0))
    for _ in range(_MOST_FACES):
        point, weights = project_onto_face(small, face)
        yield point, weights
        leaving = face & undecided & (weights < 0.0)
        entering = ~face & undecided & (small.rows @ point < small.bound)
        if not (leaving | entering).any():
            return
        face = (face & ~leaving) | entering


def project_onto_face(small: SmallProblem, face: Bool[np.ndarray, "p"]) -> tuple[Vector, Float[np.ndarray, "p"]]:
    """(d, μ) of the module's head for 𝒜 = face; μᵢ < 0 where no better ones exist."""
    rows, bound, g = small.rows[face], small.bound[face], small.center
    multipliers = np.zeros(len(face))
    if len(rows) == 0:
        return g.copy(), multipliers
    Q, R, order = pivoted_qr(rows.T, RANK_TOLERANCE)
    rank = len(R)
    R, chosen = R[:, :rank], order[:rank]
    d = g
    for _ in range(2):  # (I − QQᵀ) g: the second pass takes away what rounding left of the first
        d = d - Q @ (Q.T @ d)
    d = d + Q @ solve_upper(R, bound[chosen], transposed=True)
    weights = np.zeros(len(rows))
    weights[chosen] = solve_upper(R, Q.T @ (d - g))
    if rank < len(rows) and (weights[~small.equality[face]] < 0.0).any():
        weights = nonnegative_weights(Q.T @ rows.T, Q.T @ (d - g), small.equality[face])
    else:  # one step of refinement: nearly opposing rows have multipliers of 1e9
        weights[chosen] += solve_upper(R, Q.T @ (d - g - weights @ rows))
    multipliers[face] = weights
    return d, multipliers


def nonnegative_weights(
    columns: Float[np.ndarray, "k p"], target: Float[np.ndarray, "k"], equality: Bool[np.ndarray, "p"]
) -> Float[np.ndarray, "p"]:
    """argmin ‖columns μ − target‖ with μ ≥ 0 on I, free on E: dependent rows have many multipliers, few with signs."""
    from scipy.optimize import nnls

    count = columns.shape[1]
    try:
        parts, _ = nnls(np.hstack([columns, -columns[:, equality]]), target)
    except RuntimeError:  # its iteration limit; the core's own multipliers stand
        return np.zeros(count)
    parts[:count][equality] -= parts[count:]
    return np.asarray(parts[:count])
