"""Constrained policy optimization: the closed form of its trust-region problem with one constraint."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Vector
from ..certify import certify
from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..solvers.infeasibility import infeasible_direction
from .interface import Declaration
from .trust_region import OneRowBall, OneRowMethod, in_ball

# ‖g − (r/s) J‖ in units of ‖g‖ below which g and J point the same way, or opposite ways.
_PARALLEL = 1e-14


@dataclass(frozen=True, kw_only=True)
class CPO(OneRowMethod):
    """x* = (1/λ*) H⁻¹(g + ν*J),  ν* = (λ*c − r)₊ / s,  q = gᵀH⁻¹g, r = gᵀH⁻¹Jᵀ, s = JH⁻¹Jᵀ, δ = radius², for

        max gᵀx  s.t.  J x ≥ c,  xᵀHx ≤ δ
        λ* = √((q − r²/s) / (δ − c²/s))  where the constraint binds, √(q/δ) where the step to the ball's edge meets it

    The paper has costs, so its b = −J, and g of the loss in the dual: mixing the two is the sign error to look for. It
    picks the branch by the larger dual value; that is √(q/δ) just where √(δ/q) r ≥ c. Where not even the ball's
    best point meets the constraint, c > √(δs), the step is the recovery √(δ/s) H⁻¹Jᵀ: the least violation, INFEASIBLE.
    κ = λ*, μ = ν*, and the shortest x where several are best. One constraint, which may be switched off.
    tolerance: the worst KKT residual of an OPTIMAL answer, UNCERTIFIED beyond it.
    Source: Achiam et al. 2017, Constrained policy optimization, eq. 11–14 and Theorem 2 of the supplement.
    """

    declaration: ClassVar[Declaration] = Declaration(
        "CPO",
        "H⁻¹(g + ν*J)/λ*",
        "Achiam et al. 2017, eq. 11–14, Theorem 2",
        "the trust region in a metric, for one constraint",
    )

    def answer(self, problem: DirectionProblem) -> Direction:
        """x*, with κ = λ* and μ = ν*."""
        ball = in_ball(problem)
        if ball.bound > 1.0:  # of 0·x ≥ c > 0 too, which no step brings nearer
            step = ball.row if ball.row.any() else ball.gradient
            answer = ball.direction(problem, step, 1.0, 0.0, status=Status.INFEASIBLE)
        else:
            answer = ball.direction(problem, *_step(ball))
        return certify(problem, answer, self.tolerance, infeasible_direction)


def _step(ball: OneRowBall) -> tuple[Vector, float, float]:
    """(x, ν, λ) in the unit ball, where q = s = δ = 1 (or g = 0, or no row)."""
    g, a, c = ball.gradient, ball.row, ball.bound
    along = float(g @ a)
    if not g.any():
        return max(c, 0.0) * a, 0.0, 0.0
    if along >= c:
        return g, 0.0, 1.0
    across = g - along * a
    size = float(np.sqrt(across @ across))  # √(1 − r²), without its cancellation
    if size <= _PARALLEL:
        return c * a, -along, 0.0
    reach = float(np.sqrt((1.0 - c) * (1.0 + c)))
    if reach == 0.0:  # c = 1: the ball touches the constraint in one point, where no λ is finite
        return a, 0.0, 0.0
    lam = size / reach
    return c * a + across / size * reach, lam * c - along, lam
