"""Constraint-rectified policy optimization: climb for a violated constraint, or else for the objective."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..direction import Direction
from ..problem import DirectionProblem
from ..validation import require_nonnegative
from .function_solver import claimed_direction
from .interface import Declaration, PublishedMethod, gradients_of


@dataclass(frozen=True, kw_only=True)
class CRPO(PublishedMethod):
    """d = g where bᵢ ≤ η for all i, else Jᵢ of a violated constraint: here that of the largest bᵢ.

    In a linearized problem J d ≥ b a bound bᵢ > 0 is what constraint i lacks (`restoring`): Gᵢ − ρᵢ up to a factor. A
    switch between gradients, not a projection: in an update it looks at one of them only. slack_allowed η ≥ 0, in the
    unit of b.
    Source: Xu, Liang & Lan 2021, CRPO: a new approach for safe reinforcement learning, Algorithm 1, lines 5–10.
    """

    slack_allowed: float = 0.0

    declaration: ClassVar[Declaration] = Declaration(
        "CRPO",
        "g where b ≤ η, else the row with the largest bound",
        "Xu et al. 2021, Algorithm 1",
        "none: a switch between gradients",
        {
            "check_claims_are_certified": "constraints that are not violated now are not looked at",
            "check_stationarity": "a row of J is no g + Jᵀμ",
            "check_primal_feasibility": "g ignores all constraints, and a row of J all but one",
            "check_complementarity": "a constraint that the step violates is not tight",
            "check_gradient_kept_when_feasible": "b > 0 makes it leave g, even where J g ≥ b",
            "check_agreement_with_enumeration": "a switch is no projection",
            "check_permutation": "of equal bounds the first row is taken",
            "check_row_scaling": "b in the unit of each row decides which is taken, and d has its length",
            "check_scaling": "a row of J has its own length, whatever that of g and b",
            "check_infeasible_is_called_infeasible": "it does not ask whether a step meets the constraints",
            "check_least_violation": "it does not ask whether a step meets the constraints",
        },
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_nonnegative("slack_allowed", self.slack_allowed)

    def supports(self, problem: DirectionProblem) -> bool:
        """J d ≥ b."""
        return not problem.equality.any() and problem.metric is None and problem.radius is None

    def answer(self, problem: DirectionProblem) -> Direction:
        """g or a row of J, claimed to be OPTIMAL."""
        gradient, _ = gradients_of(problem)
        violated = problem.m > 0 and problem.bound.max() > self.slack_allowed
        value = problem.jacobian[int(np.argmax(problem.bound))] if violated else gradient
        return claimed_direction(problem, value, self.tolerance)
