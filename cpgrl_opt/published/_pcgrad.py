"""Projecting conflicting gradients: each task's gradient gives way to each other one that it opposes, in turn."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Jacobian, Vector
from ..direction import Direction
from ..problem import DirectionProblem
from ..scaling import unit_rows
from ..settings import CheckedSettings
from ..solvers.interface import unsupported
from .function_solver import claimed_direction
from .interface import Declaration, is_cone, stacked_gradients


@dataclass(frozen=True, kw_only=True)
class PCGrad(CheckedSettings):
    """d = Σᵢ gᵢᴾ;   gᵢᴾ ← gᵢᴾ − (gᵢᴾ·gⱼ / ‖gⱼ‖²) gⱼ where gᵢᴾ·gⱼ < 0, for all j ≠ i in random order, from gᵢᴾ = gᵢ.

    The tasks are the objective and the constraints alike, g₀ = g and gᵢ = Jᵢ, so d is a sum of all of them and no
    solution of a problem with one objective. A projection off gⱼ may undo that off gₖ before it: for three tasks and
    more d may oppose one. seed: of the orders, drawn anew in each call, so that the same problem has one answer.
    tolerance: what the kit holds it to.
    Source: Yu et al. 2020, Gradient surgery for multi-task learning, Algorithm 1.
    """

    seed: int = 0
    tolerance: float = 1e-6

    declaration: ClassVar[Declaration] = Declaration(
        "PCGrad",
        "Σᵢ gᵢᴾ, each gᵢ projected off the gⱼ that it opposes, one after the other",
        "Yu et al. 2020, Algorithm 1",
        "none: objective and constraints are tasks alike",
        {
            "check_claims_are_certified": "it sums over objective and constraints",
            "check_stationarity": "the sum has all gradients in it, tight or not",
            "check_primal_feasibility": "a later projection undoes an earlier one",
            "check_complementarity": "a constraint that a later projection harmed is not tight",
            "check_gradient_kept_when_feasible": "the rows are added to g in any case",
            "check_agreement_with_enumeration": "it sums over objective and constraints",
            "check_idempotence": "the rows are added once more",
            "check_non_expansiveness": "the rows' own projections move with g, whatever the rows' lengths",
            "check_firm_non_expansiveness": "the rows' own projections move with g, whatever the rows' lengths",
            "check_permutation": "the order of the projections decides",
            "check_row_scaling": "d is a sum, so it has the rows' lengths in it",
            "check_scaling": "d is a sum, of which only one part is scaled with g",
            "check_duplicate_row": "a row that is there twice is summed twice",
            "check_inactive_row": "every row is summed",
        },
    )

    def supports(self, problem: DirectionProblem) -> bool:
        """J d ≥ 0."""
        return is_cone(problem)

    def solve(self, problem: DirectionProblem) -> Direction:
        """d, claimed to be OPTIMAL."""
        if not self.supports(problem):
            return unsupported(problem)
        tasks = stacked_gradients(problem)
        return claimed_direction(problem, pcgrad(tasks, np.random.default_rng(self.seed)), self.tolerance)


def pcgrad(gradients: Jacobian, rng: np.random.Generator) -> Vector:
    """Σᵢ gᵢᴾ of the gradients of k tasks; (k, n) → (n,)."""
    units = unit_rows(gradients).jacobian
    total = np.zeros(gradients.shape[1])
    for i, gradient in enumerate(gradients):
        surgical = gradient.copy()
        for j in rng.permutation(len(gradients)):
            if j != i:
                surgical -= min(float(surgical @ units[j]), 0.0) * units[j]
        total += surgical
    return total
