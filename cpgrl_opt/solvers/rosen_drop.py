r"""Rosen's drop rule taken as a cone projection: drop the constraint with the largest positive λᵢ‖Jᵢ‖, recompute.

    d = P_𝒜 g,   λ = (J_𝒜 J_𝒜ᵀ)⁻¹ J_𝒜 g,   𝒜 ← 𝒜 \ {argmax λᵢ‖Jᵢ‖}   while max λᵢ > 0

λ is the one of least norm (λᵢ‖Jᵢ‖), where rows depend, and no constraint leaves where some λ ≤ 0 exists; what ties
leaves together: the order of the rows decides nothing, see `drop_rule`.

A constraint once dropped never comes back, so the answer may violate it: exact for one constraint, wrong in some
cases from two on, and then UNCERTIFIED. Source: §2.3 of the paper; Rosen 1960.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..problem import DirectionProblem
from ..projection import largest_multipliers, unit_multipliers
from ..scaling import lengths
from .base import SmallSolver
from .polishing import project_onto_face
from .small_problem import SmallAnswer, SmallProblem

# λᵢ‖Jᵢ‖ counts as 0 below this part of ‖g‖, or below the tolerance: far above rounding, as in a step.
_NEGLIGIBLE = 1e-10


@dataclass(frozen=True, kw_only=True)
class RosenDrop(SmallSolver):
    """The drop rule, for b = 0; equalities are never dropped.

    tolerance: the worst KKT residual of an OPTIMAL answer. raw_multipliers: compare λᵢ as printed in the paper, so
    that the choice depends on the lengths of the rows, instead of λᵢ‖Jᵢ‖.
    """

    tolerance: float = 1e-9
    raw_multipliers: bool = False

    package: ClassVar[str] = "scipy"
    source: ClassVar[str] = "Rosen 1960; §2.3 of the paper"
    guarantee: ClassVar[str] = "none: a heuristic, UNCERTIFIED where it is wrong; b = 0"

    def supports(self, problem: DirectionProblem) -> bool:
        """b = 0, or −inf where a constraint is switched off."""
        return bool(((problem.bound == 0.0) | (problem.bound == -np.inf)).all())

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """The drop rule's x and μ; `iterations` counts the constraints that were dropped."""
        active, negligible = np.ones(len(small.bound), dtype=np.bool_), min(_NEGLIGIBLE, self.tolerance)
        while True:
            d, multipliers = project_onto_face(small, active)
            rest = lengths(small.center + multipliers @ small.rows - d)
            if rest > negligible or (multipliers[~small.equality] < -negligible).any():  # of dependent rows the least
                rows = np.where(active[:, None], small.rows, 0.0)
                multipliers = -unit_multipliers(rows[None], small.center[None])[0]
            positive = active & ~small.equality & (-multipliers > negligible)  # λᵢ‖Jᵢ‖/‖g‖
            if not positive.any():
                return SmallAnswer(d, multipliers, int((~active).sum()))
            harm = -multipliers
            if self.raw_multipliers and small.lengths is not None:
                with np.errstate(over="ignore", divide="ignore"):
                    harm = harm / small.lengths
            active &= ~largest_multipliers(harm[None], -multipliers[None], positive[None])[0]
