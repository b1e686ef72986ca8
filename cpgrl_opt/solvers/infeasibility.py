"""Proof of infeasibility, and the direction that violates the constraints least.

    v = argmin ‖v‖  s.t.  Ĵd + v ≥ b̂ (I), Ĵd + v = b̂ (E) for some d
      = projection of b̂ onto {y : Ĵᵀy = 0, y ≥ 0 on I}

so v ≠ 0 is a Farkas vector itself: Ĵᵀv = 0, v ≥ 0, b̂ᵀv = ‖v‖² > 0. With N an orthonormal basis of {y : Ĵᵀy = 0},
decided at RANK_TOLERANCE, v = Nz, z = argmin ‖z − Nᵀb̂‖ s.t. Nz ≥ 0 on I: one more projection onto a cone.
All directions that violate least have Ĵd ≥ b̂ − v with equality where vᵢ ≠ 0; the answer is the nearest to g of them.
Source: Farkas' lemma; Lawson & Hanson, Solving Least Squares Problems, ch. 23; Moreau's decomposition.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..arrays import Multipliers, Vector
from ..direction import Direction, Status
from ..kkt import farkas_residual
from ..problem import DirectionProblem
from ..projection import RANK_TOLERANCE
from .kernels import compiled_kernels, solve_single
from .least_distance import least_distance
from .polishing import polished
from .reduction import ScaledProblem, reduce_problem, scale_problem

# ‖v‖ in units of s above which a problem is infeasible; below it, bounds that should agree differ by rounding.
VIOLATION_TOLERANCE = 1e-9
# v = 1e-9 has seven digits, so its certificate is this good at worst; sizeable violations reach 1e-15.
FARKAS_TOLERANCE = 1e-6
# Entries of v below this part of its largest are zeros that were rounded.
_SUPPORT_CUT = 1e-6
_CERTIFIED = 1e-12  # worst KKT residual of that projection
# Error of a computed null vector, times the least singular value that it is separated by.
_NOISE = 1e-14


@dataclass(frozen=True, eq=False)
class LeastViolation:
    """direction: (n,), violates least and is nearest to g; proof: (m,), a Farkas vector; size: ‖v‖ in units of s."""

    direction: Vector
    proof: Multipliers
    size: float


def least_violation(problem: DirectionProblem) -> LeastViolation | None:
    """The least violation where it is proven to exceed 1e-9 (or a zero row asks for something), else None."""
    scaled = scale_problem(problem)
    if not np.isfinite(scaled.scale):
        return None
    scaled, violation, d = _least_violation(scaled)
    size = float(np.sqrt(violation @ violation))
    value = d * scaled.scale
    if scaled.impossible.any():
        return LeastViolation(value, np.where(scaled.impossible, np.sign(problem.bound), 0.0), np.inf)
    if size <= VIOLATION_TOLERANCE:
        return None
    proof = scaled.original_multipliers(violation / size)
    return LeastViolation(value, proof, size) if farkas_residual(problem, proof) <= FARKAS_TOLERANCE else None


def infeasible_direction(problem: DirectionProblem, iterations: int = 0) -> Direction | None:
    """The INFEASIBLE answer of a problem that is proven to be so, else None."""
    least = least_violation(problem)
    if least is None or not np.isfinite(least.direction).all() or not np.isfinite(least.proof).all():
        return None
    return Direction(least.direction, least.proof, Status.INFEASIBLE, iterations)


def _least_violation(scaled: ScaledProblem) -> tuple[ScaledProblem, Float[np.ndarray, "p"], Vector]:
    """(problem in its last units, v, d); rows too slack to matter enter only if d violates them."""
    considered = scaled.relevant_rows()
    while True:
        part = scaled.restricted(considered)
        violation = np.zeros(len(considered))
        violation[considered] = _violation(part)
        d = _nearest(part, violation[considered])
        violated = ~considered & (scaled.rows @ d < scaled.bound)
        if not violated.any():
            return scaled, violation, d
        considered = considered | violated
        scaled = scaled.rescaled(max(1.0, float(np.sqrt(d @ d))))


def _violation(scaled: ScaledProblem) -> Float[np.ndarray, "p"]:
    """v of the module's head, supported exactly on the rows that prove it; 0 where that leaves no proof."""
    null_space = _left_null_space(scaled.rows)
    if null_space.shape[1] == 0:
        return np.zeros(len(scaled.bound))
    v = _projected(null_space, scaled.bound, scaled.equality)
    support = np.abs(v) > _SUPPORT_CUT * float(np.abs(v).max())
    # Once more on the support alone: then no entry of v is a rounded zero, and a v of 1e-9 still has Ĵᵀv = 0.
    face = _left_null_space(scaled.rows[support])
    refined = np.zeros_like(v)
    refined[support] = face @ (face.T @ scaled.bound[support])
    return refined if (refined[~scaled.equality] >= 0.0).all() else np.zeros_like(v)


def _left_null_space(rows: Float[np.ndarray, "p n"]) -> Float[np.ndarray, "p f"]:
    """Orthonormal N with rowsᵀN = 0, to RANK_TOLERANCE."""
    count, n = rows.shape
    if count == 0:
        return np.zeros((0, 0))
    if n > 2 * count:  # the singular vectors on the left survive a rotation of the right
        rows = np.linalg.qr(rows.T)[1].T
    left, values, _ = np.linalg.svd(rows, full_matrices=True)
    rank = int((values > RANK_TOLERANCE).sum())
    null_space: np.ndarray = left[:, rank:]
    # A row that takes part in no dependence has a rounded zero here, of either sign: left there, it bars a proof.
    null_space[np.abs(null_space).max(axis=1, initial=0.0) < _NOISE / values[:rank].min(initial=1.0)] = 0.0
    return null_space


def _projected(
    null_space: Float[np.ndarray, "p f"], bound: Float[np.ndarray, "p"], equality: Float[np.ndarray, "p"]
) -> Float[np.ndarray, "p"]:
    """N z, z the projection of Nᵀb onto {z : Nz ≥ 0 on I}; 0 if that is not certified, so that nothing is claimed.

    By the compiled core: scipy.optimize.nnls ends at points that are not optimal where columns nearly depend.
    """
    target = np.ascontiguousarray(null_space.T @ bound)
    nearest = solve_single(
        compiled_kernels().solve_cone,
        DirectionProblem(target, np.ascontiguousarray(null_space[~equality])),
        _CERTIFIED,
    )
    if nearest.status != Status.OPTIMAL:
        return np.zeros_like(bound)
    v: np.ndarray = null_space @ nearest.value
    return v


def _nearest(scaled: ScaledProblem, violation: Float[np.ndarray, "p"]) -> Vector:
    """argmin ‖d − g‖ s.t. Ĵd ≥ b̂ − v, = on E and where v > 0; in units of s."""
    relaxed = replace(scaled, bound=scaled.bound - violation, equality=scaled.equality | (violation > 0.0))
    reduced, basis = reduce_problem(relaxed)
    answer = least_distance(reduced)
    if answer.point is None or answer.multipliers is None:
        fallback: Vector = np.linalg.lstsq(relaxed.rows, relaxed.bound, rcond=RANK_TOLERANCE)[0]
        return fallback
    d = relaxed.gradient + basis @ (answer.point - reduced.center)
    candidates = [point for point, _ in polished(relaxed, d, answer.multipliers)]
    return min([*candidates, d], key=lambda candidate: float(relaxed.violation(candidate).max(initial=0.0)))
