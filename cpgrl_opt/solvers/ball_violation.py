"""The point of a ball that violates soft constraints least while it meets the others, where it cannot meet them all.

    x = argmin ½‖v‖²  s.t.  J_V x + v ≥ b_V,  J_S x ≥ b_S (= on E),  ‖x‖ ≤ r       V: rows that give, S: the others

With a weight κ on x it is a projection onto a cone that is never empty, if some x meets S, and ‖x‖ falls with κ:

    (x, w) = argmin ½‖x − c‖² + ½‖w‖²  s.t.  J_V x + √κ w ≥ b_V,  J_S x ≥ b_S (= on E),        v = √κ w,  c = 0

On the sphere κ is the ball's multiplier. Where all rows give, v proves that the ball misses them: Jᵀv = κx, and
bᵀv = ‖v‖² + vᵀJx = ‖v‖² + r‖Jᵀv‖ > r‖Jᵀv‖. Source: Farkas' lemma; Moré & Sorensen 1983.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import Bool, Float, Multipliers, Vector
from ..direction import DirectionError, Status
from ..problem import DirectionProblem
from ..scaling import demand, norm
from .exact_core import project

# Worst residual of a soft problem, of which the search looks at ‖x‖ alone: a decade up or down moved no bit of 504
# answers in balls.
_CERTIFIED = 1e-9
# A ball is in the way where x of this κ is longer than its radius. With 1e-7 rows that are 1e-6 rad from opposing, and
# met far away, are taken for met nowhere, and x stops short of the sphere; with 1e-15 soft rows lie 4e-8 rad apart.
_LEAST_WEIGHT = 1e-13
# Where it is known to be in the way, κ is about bθ/radius of rows at θ from opposing: below this float64 sees no θ.
_LEAST_OF_ALL, _FARTHER = 1e-24, 1e-3


@dataclass(frozen=True, eq=False)
class SoftRows:
    """Unit rows that are on and their bounds; gives: V."""

    jacobian: Float[np.ndarray, "p n"]
    bound: Float[np.ndarray, "p"]
    equality: Bool[np.ndarray, "p"]
    gives: Bool[np.ndarray, "p"]

    def soften(self, weight: float, center: Vector | None = None) -> Vector:
        """x of the module's head for κ = weight and c = center; DirectionError where the core breaks down."""
        count, n = self.jacobian.shape
        soft = np.ascontiguousarray(np.hstack([self.jacobian, math.sqrt(weight) * np.eye(count)[:, self.gives]]))
        gradient = np.zeros(soft.shape[1])
        gradient[:n] = 0.0 if center is None else center
        problem = DirectionProblem.trusted(gradient, soft, self.bound.copy(), self.equality.copy())
        answer = project(problem, _CERTIFIED)
        if answer.status not in (Status.OPTIMAL, Status.UNCERTIFIED):
            raise DirectionError(str(answer.status))
        return np.asarray(answer.value[:n])

    def violation(self, x: Vector) -> Float[np.ndarray, "p"]:
        """v of x on V; 0 on S."""
        lack = self.bound - self.jacobian @ x
        return np.where(self.gives, np.where(self.equality, lack, np.maximum(lack, 0.0)), 0.0)

    def violate_least(self, radius: float, *, is_missed: bool = False) -> Vector | None:
        """x on the sphere, by a search for log κ; None where the ball is not in the way. is_missed: it surely is."""
        least = _LEAST_WEIGHT
        while norm(self.soften(least)) <= radius:
            if not is_missed or least < _LEAST_OF_ALL:
                return None
            least *= _FARTHER
        from scipy.optimize import brentq  # first use only: importing the package stays light

        def excess(exponent: float) -> float:
            return math.log(max(norm(self.soften(math.exp(exponent))) / radius, 1e-300))

        # κ‖x‖² ≤ vᵀJ_V x ≤ ‖v‖ √p ‖x‖, and ‖v‖ is at most what x = 0 leaves of the bounds.
        asked = norm(np.maximum(demand(self.bound, self.equality)[self.gives], 0.0))
        highest = math.log(math.sqrt(len(self.bound)) * asked / radius) + 1.0
        x = self.soften(math.exp(brentq(excess, math.log(least), highest, xtol=1e-15, rtol=1e-15)))
        return x * min(1.0, radius / norm(x))  # by rounding beside large bounds it may be 1e-12 outside


def least_violation_in_ball(
    rows: Float[np.ndarray, "m n"], bound: Multipliers, equality: Bool[np.ndarray, "m"]
) -> tuple[Vector, Multipliers]:
    """(x, v) in the unit ball, of unit rows that all give, zero rows being switched off; v = 0 where none is found."""
    on, violation = bound > -np.inf, np.zeros(len(bound))
    soft = SoftRows(rows[on], bound[on], equality[on], np.ones(int(on.sum()), np.bool_))
    try:
        point = soft.violate_least(1.0, is_missed=True)
    except DirectionError:
        point = None
    if point is None:
        return np.zeros(rows.shape[1]), violation
    violation[on] = soft.violation(point)
    return point, violation
