"""Recovery: where linearized constraints contradict each other, those that are violated give way, and the others hold.

    v = argmin ½‖v‖²      s.t.  Ĵ_V d + v ≥ b̂_V,   Ĵ_S d ≥ b̂_S   for some d           V: rows with b > 0, S: the others
    d = argmin ½‖d − g‖²  s.t.  Ĵ_V d ≥ b̂_V − v,   Ĵ_S d ≥ b̂_S                       in a ball: max gᵀd, ‖d‖ ≤ radius

d = 0 meets S, so that V can always give way alone. What finds v has a weight κ on d and is never infeasible,

    (d, w) = argmin ½‖d − c‖² + ½‖w‖²   s.t.  Ĵ_V d + √κ w ≥ b̂_V,   Ĵ_S d ≥ b̂_S,        v = √κ w

and Ĵᵀμ = d − c of its multipliers. Without a ball c ← d for a small κ, until v stays. In a ball that the shortest such
d is too long for, c = 0, and κ is the ball's multiplier: ‖d‖, which falls with κ, is the radius. The proof that nothing
meets all of the rows is the solver's.
Source: Rockafellar 1976, Monotone operators and the proximal point algorithm; Moré & Sorensen 1983 for the ball.
"""

import math
from dataclasses import dataclass

import numpy as np

from .arrays import Float, Vector
from .direction import DirectionError, Status
from .problem import DirectionProblem, ProblemBatch
from .scaling import norm, unit_rows
from .solvers import ActiveSet, solve_batch

# κ of the proximal steps: each leaves κ/(κ + σ²) of an error along rows with the singular value σ. With 1e-4 rows at
# 0.01 rad take ten times as long; with 1e-10 the soft rows lie 1e-5 rad apart, and v loses a digit or two.
_WEIGHT = 1e-7
_MOST_STEPS = 100
_STAYS = 1e-13  # change of v, in units of the largest b̂_V, that is rounding
# S missed by less than this, in units of the longer of d and b̂_V, is met: what least violation of all leaves of a row
# that it does not violate.
_MET = 1e-12
_ROUNDING = 8 * float(np.finfo(np.float64).eps)  # of b̂ − Ĵd, for d of length 1
# A ball is in the way where d of this κ is longer than its radius. With 1e-7 rows that are 1e-6 rad from opposing, and
# met far away, are taken for met nowhere, and d stops short of the sphere; with 1e-15 soft rows lie 4e-8 rad apart.
_LEAST_WEIGHT = 1e-13


@dataclass(frozen=True, eq=False)
class _Rows:
    """Unit rows that are on and their bounds, in units of the largest b̂_V; gives: V."""

    jacobian: Float[np.ndarray, "p n"]
    bound: Float[np.ndarray, "p"]
    gives: np.ndarray

    def soften(self, weight: float, center: Vector) -> Vector:
        """d of the module's head for κ = weight and c = center; DirectionError where the core breaks down."""
        count, n = int(self.gives.sum()), self.jacobian.shape[1]
        soft = np.zeros((len(self.bound), n + count))
        soft[:, :n] = self.jacobian
        soft[self.gives, range(n, n + count)] = math.sqrt(weight)
        gradient = np.append(center, np.zeros(count))
        none = np.zeros(len(self.bound), np.bool_)
        answer = ActiveSet().solve(DirectionProblem.trusted(gradient, soft, self.bound.copy(), none))
        if answer.status not in (Status.OPTIMAL, Status.UNCERTIFIED):
            raise DirectionError(str(answer.status))
        d: Vector = answer.value[:n]
        return d

    def violation(self, d: Vector) -> Float[np.ndarray, "p"]:
        """v of d on V; 0 on S."""
        return np.where(self.gives, np.maximum(self.bound - self.jacobian @ d, 0.0), 0.0)


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
    rows = _Rows(np.ascontiguousarray(unit.jacobian[on]), bound[on] / scale, bound[on] > 0.0)
    missed = np.where(rows.gives, 0.0, rows.bound - rows.jacobian @ (found / scale)).max()
    if missed <= _MET * max(1.0, norm(found) / scale):
        return None
    radius = math.inf if problem.radius is None else problem.radius / scale
    try:
        return scale * _violate_least(rows, problem.gradient / scale, radius)
    except DirectionError:  # the solver's own least violation is there
        return None


def _violate_least(rows: _Rows, gradient: Vector, radius: float) -> Vector:
    if norm(rows.soften(_LEAST_WEIGHT, np.zeros_like(gradient))) > radius:
        return _on_sphere(rows, radius)
    d = _approach(rows)
    rounding = _ROUNDING * max(1.0, norm(d))  # which would else be all that rows which oppose each other ask for
    given = np.where(rows.gives, rows.bound - rows.violation(d) - rounding, rows.bound)
    nearest = _nearest(rows, given, gradient, None if radius == math.inf else radius)
    return d if nearest is None else nearest


def _approach(rows: _Rows) -> Vector:
    """A d that violates least, without a ball."""
    d = np.zeros(rows.jacobian.shape[1])
    v = rows.violation(d)
    for _ in range(_MOST_STEPS):
        d = rows.soften(_WEIGHT, d)
        before, v = v, rows.violation(d)
        if np.abs(v - before).max() <= _STAYS:
            break
    return d


def _nearest(rows: _Rows, bound: Float[np.ndarray, "p"], gradient: Vector, radius: float | None) -> Vector | None:
    """Of what meets these bounds; rounding may leave nothing that does, and then the least violation is as good."""
    none = np.zeros((1, len(bound)), np.bool_)
    problems = ProblemBatch.trusted(gradient[None].copy(), rows.jacobian[None], bound[None], none)
    [answer] = solve_batch(ActiveSet(), problems.in_geometry(None, radius))
    return answer.value if answer.status in (Status.OPTIMAL, Status.INFEASIBLE) else None


def _on_sphere(rows: _Rows, radius: float) -> Vector:
    """d with ‖d‖ = radius by a search for log κ."""
    from scipy.optimize import brentq  # first use only: importing the package stays light

    center = np.zeros(rows.jacobian.shape[1])

    def excess(exponent: float) -> float:
        return math.log(max(norm(rows.soften(math.exp(exponent), center)) / radius, 1e-300))

    # ½κ‖d‖² ≤ ½‖b̂_V‖², which d = 0 has.
    high = 2.0 * math.log(norm(rows.bound[rows.gives]) / radius) + 1.0
    low = math.log(_LEAST_WEIGHT)
    d = rows.soften(math.exp(brentq(excess, low, high, xtol=1e-15, rtol=1e-15)), center)
    return d * min(1.0, radius / norm(d))  # by rounding beside large b̂_V it may be 1e-12 outside
