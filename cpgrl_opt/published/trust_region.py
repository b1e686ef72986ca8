"""A trust region with one constraint in its own units: H = I, ‖g‖ = ‖J‖ = radius = 1.

    max gᵀx  s.t.  J x ≥ c,  xᵀHx ≤ δ,    H = LLᵀ:    ĝ = L⁻¹g/√q,  â = L⁻¹Jᵀ/√s,  ĉ = c/√(sδ),  x = √δ L⁻ᵀx̂

with q = gᵀH⁻¹g and s = JH⁻¹Jᵀ, so that λ = λ̂ √(q/δ) and ν = ν̂ √(q/s).
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Vector
from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..scaling import lengths
from .euclidean import euclidean
from .function_solver import require_finite
from .interface import PublishedMethod


@dataclass(frozen=True, eq=False)
class OneRowBall:
    """ĝ and â of length 1 (0 where g or J is), ĉ, and what takes a step back: √q, √s and the radius."""

    gradient: Vector
    row: Vector
    bound: float
    gradient_size: float
    row_size: float
    radius: float

    def direction(
        self, problem: DirectionProblem, step: Vector, weight: float, curvature: float, status: Status = Status.OPTIMAL
    ) -> Direction:
        """x, μ = ν and κ = λ in the problem's units, of x̂, ν̂ and λ̂; for INFEASIBLE ν̂ is a Farkas vector as it is."""
        value = self.radius * step
        if problem.whitening is not None:
            value = problem.whitening.original(value)
        on = problem.bound > -np.inf
        if status == Status.INFEASIBLE:
            return Direction(value, np.where(on, weight, 0.0), status)
        force = self.gradient_size
        multiplier = weight * force / self.row_size if self.row_size > 0 else 0.0
        kappa = curvature * force / self.radius
        return Direction(value, np.where(on, multiplier, 0.0), status, radius_multiplier=kappa)


class OneRowMethod(PublishedMethod):
    """A method for trust regions, in a metric or none, of at most one constraint."""

    takes_geometry: ClassVar[bool] = True

    def supports(self, problem: DirectionProblem) -> bool:
        """A radius, and at most one inequality."""
        return problem.radius is not None and problem.m <= 1 and not problem.equality.any()


def in_ball(problem: DirectionProblem) -> OneRowBall:
    """The problem in its own units; ĉ = −inf without a constraint, +inf where J = 0 and c > 0."""
    require_finite(problem)
    flat, radius = euclidean(problem), float(problem.radius or 0.0)
    row = flat.jacobian[0] if problem.m else np.zeros(problem.n)
    bound = float(problem.bound[0]) if problem.m else -np.inf
    gradient_size, row_size = float(lengths(flat.gradient)), float(lengths(row))
    scaled = bound / row_size / radius if row_size > 0 else np.copysign(np.inf, bound or -1.0)
    return OneRowBall(
        flat.gradient / (gradient_size or 1.0), row / (row_size or 1.0), scaled, gradient_size, row_size, radius
    )
