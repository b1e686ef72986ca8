"""Unconflicting projection of gradients: the mean of all gradients, each projected so that it opposes none."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Jacobian, Vector
from ._dual_cone import dual_projection
from .interface import Declaration, TaskMethod


@dataclass(frozen=True, kw_only=True)
class UPGrad(TaskMethod):
    """d = (1/k) Σᵢ π(gᵢ),   π the projection onto the dual cone {x : gⱼᵀx ≥ 0 for all j}.

    The tasks are the objective and the constraints alike, g₀ = g and gᵢ = Jᵢ, k = 1 + m. Each π(gᵢ) is our cone
    problem; their mean is none, but it opposes no task: J d ≥ 0 and gᵀd ≥ 0.
    Source: Quinton & Rey 2024, Jacobian descent for multi-objective optimization, §2.2 (𝒜_UPGrad), Proposition 1.
    """

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

    def combine(self, tasks: Jacobian) -> Vector:
        """(1/k) Σᵢ π(gᵢ)."""
        return np.asarray(np.mean([dual_projection(task, tasks)[0] for task in tasks], axis=0))
