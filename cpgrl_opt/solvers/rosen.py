"""Rosen's gradient projection in closed form: the exact answer where every constraint is an equality.

    d = Pg + J⁺b,   P = I − Jᵀ(JJᵀ)⁻¹J,   Jᵀμ = d − g

by an orthonormal basis of the unit rows, compiled. Source: Rosen 1960; eq. 7–10 of the paper (λ = −μ).
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch
from .base import Solver
from .exact_core import climb, project, project_batch, solve_small_exactly
from .small_problem import SmallAnswer, SmallProblem


@dataclass(frozen=True, kw_only=True)
class Rosen(Solver):
    """The paper's tangent direction: rank-revealing on unit rows, equalities only.

    tolerance: the worst KKT residual of an OPTIMAL answer.
    """

    tolerance: float = 1e-9

    package: ClassVar[str] = "numba"
    source: ClassVar[str] = "Rosen 1960; eq. 7–10 of the paper"
    guarantee: ClassVar[str] = "exact: closed form, equalities only; compiled, batched"

    def supports(self, problem: DirectionProblem) -> bool:
        """Equalities, and inequalities that are switched off (b = −inf)."""
        return bool((problem.equality | (problem.bound == -np.inf)).all())

    def solve_rows(self, problem: DirectionProblem) -> Direction:
        """The certified direction; UNSUPPORTED, with zeros, where an inequality is switched on."""
        return project(problem, self.tolerance, tangent=True)

    def solve_rows_batch(self, problems: ProblemBatch) -> DirectionBatch:
        """B problems in one compiled call, each exactly as alone."""
        return project_batch(problems, self.tolerance, tangent=True)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """The exact core, as the ball's search asks it."""
        return solve_small_exactly(small, tangent=True)

    def climb(self, problems: ProblemBatch) -> DirectionBatch:
        """The usual ones in one compiled call."""
        return climb(problems, self.tolerance, tangent=True)
