"""Projecting conflicting gradients: each task's gradient gives way to each other one that it opposes, in turn."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Jacobian, Vector
from ..scaling import unit_rows
from .interface import Declaration, TaskMethod


@dataclass(frozen=True, kw_only=True)
class PCGrad(TaskMethod):
    """d = Σᵢ gᵢᴾ;   gᵢᴾ ← gᵢᴾ − (gᵢᴾ·gⱼ / ‖gⱼ‖²) gⱼ where gᵢᴾ·gⱼ < 0, for all j ≠ i in random order, from gᵢᴾ = gᵢ.

    The tasks are the objective and the constraints alike, g₀ = g and gᵢ = Jᵢ, so d is a sum of all of them and no
    solution of a problem with one objective. A projection off gⱼ may undo that off gₖ before it: for three tasks and
    more d may oppose one. seed: of the orders, drawn anew in each call, so that the same problem has one answer.
    Source: Yu et al. 2020, Gradient surgery for multi-task learning, Algorithm 1.
    """

    seed: int = 0

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

    def combine(self, tasks: Jacobian) -> Vector:
        """Σᵢ gᵢᴾ."""
        units, rng = unit_rows(tasks).jacobian, np.random.default_rng(self.seed)
        total = np.zeros(tasks.shape[1])
        for i, gradient in enumerate(tasks):
            surgical = gradient.copy()
            for j in rng.permutation(len(tasks)):
                if j != i:
                    surgical -= min(float(surgical @ units[j]), 0.0) * units[j]
            total += surgical
        return total
