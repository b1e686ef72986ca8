"""Proof of infeasibility, and the direction that violates the constraints least.

    v = argmin ‖v‖  s.t.  Ĵd + v ≥ b̂ (I), Ĵd + v = b̂ (E) for some d
      = projection of b̂ onto {y : Ĵᵀy = 0, y ≥ 0 on I}

so v ≠ 0 is a Farkas vector itself: Ĵᵀv = 0, v ≥ 0, b̂ᵀv = ‖v‖² > 0. All directions that violate least have
Ĵd ≥ b̂ − v with equality where vᵢ ≠ 0; the answer is the nearest to g of them. Both are projections onto a polyhedron
and found by the compiled core, whichever solver asks; what it finds is a claim here, and goes before the referee.
Source: Farkas' lemma; Moreau's decomposition.
"""

from dataclasses import replace

import numpy as np

from ..arrays import Multipliers
from ..certify import is_proven
from ..direction import Direction, Status
from ..problem import DirectionProblem, without_geometry
from ..scaling import demand
from .exact_core import project

# Σ bᵢyᵢ / Σ |bᵢyᵢ| above which a problem is infeasible; bounds that should agree may differ by rounding.
VIOLATION_TOLERANCE = 1e-9
_EXACT = 1e-12  # worst KKT residual of the projections


def infeasible_direction(problem: DirectionProblem, iterations: int = 0) -> Direction | None:
    """The INFEASIBLE answer where the least violation is proven to exceed 1e-9, or a zero row asks for something.

    value: violates least and is nearest to g; multipliers: a Farkas vector. None where that is not proven.
    """
    problem = without_geometry(problem)  # and contiguous: a long problem's arrays may lie anyhow
    answer = project(problem, _EXACT)
    if answer.status != Status.INFEASIBLE or not is_proven(problem, answer):
        return None
    asking = demand(problem.bound, problem.equality) > 0.0
    # Where a zero row asks for something, there is nothing to measure it in.
    is_one = (asking & ~problem.jacobian.any(axis=1)).any()
    if not is_one and _excess(problem.bound, answer.multipliers) <= VIOLATION_TOLERANCE:
        return None
    return replace(answer, iterations=iterations)


def _excess(bound: Multipliers, y: Multipliers) -> float:
    """Σ bᵢyᵢ / Σ |bᵢyᵢ|, which the lengths of the rows leave as it is; 0 where y names no bound that is not 0."""
    b, y = bound[y != 0.0], y[y != 0.0]
    if not b.any():
        return 0.0
    terms = (b / np.abs(b).max()) * (y / np.abs(y).max())
    return float(terms.sum() / np.abs(terms).sum()) if terms.any() else 0.0
