"""Averaged gradient episodic memory: one constraint, the mean of all."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..scaling import lengths
from .interface import Declaration, PublishedMethod, gradients_of

# ‖r‖ that rounding leaves of rows that sum to 0, over the longest row.
_ROUNDING = 1e-14


@dataclass(frozen=True, kw_only=True)
class AGEM(PublishedMethod):
    """g̃ = g where gᵀr ≥ 0, else g − (gᵀr / rᵀr) r,   r = (1/m) Σ J_k.

    The projection onto the one half-space rᵀd ≥ 0, so our cone problem where m = 1; otherwise that of another, larger
    set: Σ J_k d ≥ 0 allows one constraint to be harmed as long as the others gain more. μ_k = −(gᵀr / rᵀr)/m.
    Source: Chaudhry et al. 2019, Efficient lifelong learning with A-GEM, eq. 11 (r is their g_ref).
    """

    declaration: ClassVar[Declaration] = Declaration(
        "A-GEM",
        "g − min(gᵀr, 0)/(rᵀr) r, r the mean of the rows",
        "Chaudhry et al. 2019, eq. 11",
        "the cone problem, b = 0, for one constraint; for more, that of their mean",
        {
            "check_claims_are_certified": "one constraint may be harmed where the mean of all gains",
            "check_primal_feasibility": "one constraint may be harmed where the mean of all gains",
            "check_complementarity": "every row has the same share of the multiplier, tight or not",
            "check_agreement_with_enumeration": "the set is that of the mean constraint",
            "check_row_scaling": "long rows weigh more in the mean",
            "check_duplicate_row": "a row that is there twice weighs twice in the mean",
            "check_inactive_row": "every row turns the mean",
        },
    )

    def answer(self, problem: DirectionProblem) -> Direction:
        """g̃, claimed to be OPTIMAL."""
        gradient, rows = gradients_of(problem)
        multipliers = np.zeros(problem.m)
        reference = rows.mean(axis=0) if len(rows) else np.zeros(problem.n)
        size = float(lengths(reference))
        if size <= _ROUNDING * float(lengths(rows).max(initial=0.0)):
            return Direction(gradient.copy(), multipliers, Status.OPTIMAL)
        unit = reference / size  # rᵀr of rows at 1e-170 is 0
        along = min(float(gradient @ unit), 0.0)
        multipliers[problem.bound > -np.inf] = -along / size / len(rows)
        return Direction(gradient - along * unit, multipliers, Status.OPTIMAL)
