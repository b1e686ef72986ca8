"""Rosen's gradient projection in closed form: the exact answer where every constraint is an equality.

d = Pg + J⁺b,   P = I − Jᵀ(JJᵀ)⁻¹J,   Jᵀμ = d − g
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..direction import Direction, Status
from ..problem import DirectionProblem
from .polishing import project_onto_face
from .preparation import candidate_of, failure, judged, screen
from .reduction import scale_problem


@dataclass(frozen=True, kw_only=True)
class Rosen:
    """The paper's tangent direction: rank-revealing on unit rows, equalities only.

    tolerance: the worst KKT residual of an OPTIMAL answer.
    """

    tolerance: float = 1e-9

    package: ClassVar[str] = "numba"
    source: ClassVar[str] = "Rosen 1960; eq. 7–10 of the paper"
    guarantee: ClassVar[str] = "exact: closed form; equalities only"

    def supports(self, problem: DirectionProblem) -> bool:
        """Equalities, and inequalities that are switched off (b = −inf)."""
        return bool((problem.equality | (problem.bound == -np.inf)).all())

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction; UNSUPPORTED, with zeros, where an inequality is switched on."""
        if not self.supports(problem):
            return failure(problem, Status.UNSUPPORTED)
        scaled = scale_problem(problem)
        screened = screen(scaled)
        if screened is not None:
            return screened
        d, multipliers = project_onto_face(scaled, scaled.equality)
        return judged(problem, candidate_of(scaled, d, multipliers), self.tolerance, 1)
