"""Projection-based constrained policy optimization: the trust-region step, then the nearest point that is safe."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..scaling import lengths, unit_rows
from ..validation import require_member
from .interface import Declaration
from .trust_region import OneRowMethod, in_ball


@dataclass(frozen=True, kw_only=True)
class PCPO(OneRowMethod):
    """x½ = √(δ/q) H⁻¹g,    x = x½ + ((c − J x½)₊ / (J L⁻¹Jᵀ)) L⁻¹Jᵀ,    δ = radius², q = gᵀH⁻¹g.

    First max gᵀx s.t. xᵀHx ≤ δ, then min ½(x − x½)ᵀL(x − x½) s.t. J x ≥ c, the second without the ball. The paper has
    costs: its a = −J, b = c. projection: "kl", L = H, or "l2", L = I. With "kl" it has the multipliers of the trust
    region, κ = √(q/δ) and μ = κ times the step along H⁻¹Jᵀ, so Hx is stationary; but x is inside the ball where the
    projection shortened it (CPO goes on to its edge: for c = 0 the same way, only farther), and outside where c asks
    for more. Equal to CPO where x½ is feasible.
    Source: Yang et al. 2020, Projection-based constrained policy optimization, §4 (reward step, projection step).
    """

    projection: str = "kl"

    declaration: ClassVar[Declaration] = Declaration(
        "PCPO",
        "√(δ/q) H⁻¹g, then its projection onto J x ≥ c",
        "Yang et al. 2020, §4",
        "none: the trust region's only where its step without the constraint is feasible; else two in a row",
        {
            "check_claims_are_certified": "the ball is slack, or left, where the projection moved the step",
            "check_primal_feasibility": "the projection may leave the ball, where c > 0",
            "check_complementarity": "the projection shortens the step, and κ > 0 stays behind",
            "check_agreement_with_enumeration": "the trust region's optimum goes on along the constraint to the edge",
            "check_infeasible_is_called_infeasible": "it leaves the ball for the constraint, and calls that optimal",
            "check_least_violation": "it says OPTIMAL where the ball misses the constraint",
        },
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_member("projection", self.projection, ("kl", "l2"))

    def answer(self, problem: DirectionProblem) -> Direction:
        """x, claimed to be OPTIMAL."""
        ball = in_ball(problem)
        if ball.bound == np.inf:  # 0·x ≥ c > 0: nothing to project onto
            return ball.direction(problem, ball.gradient, 1.0, 0.0, status=Status.INFEASIBLE)
        lack = max(ball.bound - float(ball.gradient @ ball.row), 0.0)
        answer = ball.direction(problem, ball.gradient + lack * ball.row, lack, 1.0)
        return answer if self.projection == "kl" else self._nearest(problem, answer)

    def _nearest(self, problem: DirectionProblem, kl: Direction) -> Direction:
        """The same with L = I: along Jᵀ instead of H⁻¹Jᵀ."""
        ball = in_ball(problem)
        first = ball.direction(problem, ball.gradient, 0.0, 1.0).value
        value = first
        if problem.m and ball.row_size > 0:
            unit, size = unit_rows(problem.jacobian).jacobian[0], float(lengths(problem.jacobian[0]))
            value = first + max(float(problem.bound[0]) / size - float(unit @ first), 0.0) * unit
        return Direction(value, kl.multipliers, kl.status, radius_multiplier=kl.radius_multiplier)
