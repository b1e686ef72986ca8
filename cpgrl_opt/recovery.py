"""Recovery: where linearized constraints contradict each other, those that are violated give way, and the others hold.

    v = argmin ½‖v‖²      s.t.  Ĵ_V d + v ≥ b̂_V,   Ĵ_S d ≥ b̂_S   for some d           V: rows with b > 0, S: the others
    d = argmin ½‖d − g‖²  s.t.  Ĵ_V d ≥ b̂_V − v,   Ĵ_S d ≥ b̂_S                       in a ball: max gᵀd, ‖d‖ ≤ radius

d = 0 meets S, so that V can always give way alone. What finds v, with a small weight κ on d − c, is in
`ball_violation`. Without a ball c ← d, until v stays. In a ball that the shortest such d is too long for, c = 0 and
‖d‖ = radius. The proof that nothing meets all of the rows is the solver's.
Source: Rockafellar 1976, Monotone operators and the proximal point algorithm.
"""

import math

import numpy as np

from .arrays import Vector
from .direction import DirectionError, Status
from .problem import DirectionProblem, ProblemBatch
from .scaling import norm, unit_rows
from .solvers import ActiveSet, solve_batch
from .solvers.ball_violation import SoftRows

# κ of the proximal steps: each leaves κ/(κ + σ²) of an error along rows with the singular value σ. With 1e-4 rows at
# 0.01 rad take ten times as long; with 1e-10 the soft rows lie 1e-5 rad apart, and v loses a digit or two.
_WEIGHT = 1e-7
_MOST_STEPS = 100  # of a linear rate, see _WEIGHT: a few where rows are well apart
_STAYS = 1e-13  # change of v, in units of the largest b̂_V, that is rounding
# S missed by less than this, in units of the longer of d and b̂_V, is met: what least violation of all leaves of a row
# that it does not violate.
_MET = 1e-12
_ROUNDING = 8 * float(np.finfo(np.float64).eps)  # of b̂ − Ĵd, for d of length 1


def recover(problem: DirectionProblem, found: Vector) -> Vector | None:
    """The recovery of an infeasible problem of inequalities, M = I; None where `found` is one, or the core breaks down.

    found: its least violation of all rows alike, which is a recovery where it meets S.
    """
    unit = unit_rows(problem.jacobian)
    bound = unit.per_length(problem.bound)
    on = (bound > -np.inf) & (unit.largest > 0.0)
    scale = float(bound[on].max(initial=0.0))
    if not scale > 0.0:
        return None
    jacobian = np.ascontiguousarray(unit.jacobian[on])
    rows = SoftRows(jacobian, bound[on] / scale, problem.equality[on], bound[on] > 0.0)
    missed = np.where(rows.gives, 0.0, rows.bound - rows.jacobian @ (found / scale)).max()
    if missed <= _MET * max(1.0, norm(found) / scale):
        return None
    radius = math.inf if problem.radius is None else problem.radius / scale
    try:
        return scale * _violate_least(rows, problem.gradient / scale, radius)
    except DirectionError:  # the solver's own least violation is there
        return None


def _violate_least(rows: SoftRows, gradient: Vector, radius: float) -> Vector:
    d = rows.violate_least(radius)
    if d is not None:
        return d
    d = _approach(rows)
    rounding = _ROUNDING * max(1.0, norm(d))  # which would else be all that rows which oppose each other ask for
    given = np.where(rows.gives, rows.bound - rows.violation(d) - rounding, rows.bound)
    one = gradient[None].copy(), rows.jacobian[None], given[None], rows.equality[None]
    problem = ProblemBatch.trusted(*one).in_geometry(None, None if radius == math.inf else radius)
    [answer] = solve_batch(ActiveSet(), problem)
    # Rounding may leave nothing that meets these bounds, and then the least violation is as good.
    return answer.value if answer.status in (Status.OPTIMAL, Status.INFEASIBLE) else d


def _approach(rows: SoftRows) -> Vector:
    """A d that violates least, without a ball."""
    d = np.zeros(rows.jacobian.shape[1])
    v = rows.violation(d)
    for _ in range(_MOST_STEPS):
        d = rows.soften(_WEIGHT, d)
        before, v = v, rows.violation(d)
        if np.abs(v - before).max() <= _STAYS:
            break
    return d
