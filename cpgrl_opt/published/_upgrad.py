"""Unconflicting projection of gradients: the mean of all gradients, each projected so that it opposes none."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Jacobian, Vector
from ..direction import Direction
from ..problem import DirectionProblem
from ..settings import CheckedSettings
from ..solvers.interface import unsupported
from ._dual_cone import dual_projection
from .function_solver import claimed_direction
from .interface import Declaration, is_cone, stacked_gradients


@dataclass(frozen=True, kw_only=True)
class UPGrad(CheckedSettings):
    """d = (1/k) Σᵢ π(gᵢ),   π the projection onto the dual cone {x : gⱼᵀx ≥ 0 for all j}.

    The tasks are the objective and the constraints alike, g₀ = g and gᵢ = Jᵢ, k = 1 + m. Each π(gᵢ) is our cone
    problem; their mean is none, but it opposes no task: J d ≥ 0 and gᵀd ≥ 0. tolerance: what the kit holds it to.
    Source: Quinton & Rey 2024, Jacobian descent for multi-objective optimization, §2.2 (𝒜_UPGrad), Proposition 1.
    """

    tolerance: float = 1e-6

    declaration: ClassVar[Declaration] = Declaration(
        "UPGrad",
        "mean of π(gᵢ) over g and the rows, π the projection onto the cone that opposes none of them",
        "Quinton & Rey 2024, §2.2",
        "none: a mean of 1 + m cone problems, objective and constraints being tasks alike; d meets J d ≥ 0",
        {
            "check_claims_are_certified": "the mean over all tasks is not the vector nearest to g",
            "check_stationarity": "g has the weight 1/k, and rows have weights that are not tight",
            "check_gradient_kept_when_feasible": "the rows are in the mean in any case",
            "check_agreement_with_enumeration": "the mean over all tasks is not the vector nearest to g",
            "check_idempotence": "the rows are in the mean once more",
            "check_non_expansiveness": "the cone turns with g, and long rows' projections move far",
            "check_firm_non_expansiveness": "the cone turns with g, and long rows' projections move far",
            "check_row_scaling": "the rows' lengths are in the mean",
            "check_scaling": "only one part of the mean is scaled with g",
            "check_duplicate_row": "a row that is there twice is in the mean twice",
            "check_inactive_row": "every row is in the mean",
        },
    )

    def supports(self, problem: DirectionProblem) -> bool:
        """J d ≥ 0."""
        return is_cone(problem)

    def solve(self, problem: DirectionProblem) -> Direction:
        """d, claimed to be OPTIMAL."""
        if not self.supports(problem):
            return unsupported(problem)
        return claimed_direction(problem, upgrad(stacked_gradients(problem)), self.tolerance)


def upgrad(gradients: Jacobian) -> Vector:
    """(1/k) Σᵢ π(gᵢ) of the gradients of k tasks; (k, n) → (n,)."""
    projected = [dual_projection(gradient, gradients)[0] for gradient in gradients]
    return np.asarray(np.mean(projected, axis=0))
