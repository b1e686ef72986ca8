"""Gradient episodic memory: the nearest direction that hurts no remembered task."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..certify import certify
from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..solvers.infeasibility import infeasible_direction
from ..validation import require_nonnegative
from ._dual_cone import dual_projection
from .function_solver import claimed_direction
from .interface import Declaration, PublishedMethod, gradients_of


@dataclass(frozen=True, kw_only=True)
class GEM(PublishedMethod):
    """g̃ = g + Jᵀ(v* + γ),   v* = argmin_{v ≥ 0} ½ vᵀJJᵀv + gᵀJᵀv.

    With γ = 0 the dual of min ½‖g − g̃‖² s.t. ⟨g̃, g_k⟩ ≥ 0, so our cone problem: rows J_k = g_k, b = 0, μ = v*. The
    paper descends: its g and g_k are gradients of losses, the negatives of ours; with both turned round nothing
    changes but the sign of g̃. (Its G = −(g_k) is a slip: ⟨g̃, g_k⟩ ≥ 0 is what its dual solves with G = (g_k).)
    memory_strength γ ≥ 0 is added to every v_k, "biased to favour backward transfer": then it is no projection.
    tolerance: the worst KKT residual of an OPTIMAL answer at γ = 0, UNCERTIFIED beyond it.
    Source: Lopez-Paz & Ranzato 2017, Gradient episodic memory for continual learning, eq. 8–11.
    """

    memory_strength: float = 0.0

    declaration: ClassVar[Declaration] = Declaration(
        "GEM",
        "g + Jᵀv*, v* = argmin_{v ≥ 0} ‖g + Jᵀv‖",
        "Lopez-Paz & Ranzato 2017, eq. 8–11",
        "the cone problem, b = 0",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_nonnegative("memory_strength", self.memory_strength)

    def answer(self, problem: DirectionProblem) -> Direction:
        """g̃ and v*; at γ = 0 the referee judges it."""
        gradient, rows = gradients_of(problem)
        value, weights = dual_projection(gradient, rows)
        if self.memory_strength > 0:
            return claimed_direction(problem, value + self.memory_strength * rows.sum(axis=0), self.tolerance)
        multipliers = np.zeros(problem.m)
        multipliers[problem.bound > -np.inf] = weights
        answer = Direction(value, multipliers, Status.OPTIMAL)
        return certify(problem, answer, self.tolerance, infeasible_direction)
