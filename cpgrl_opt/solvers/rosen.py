"""Rosen's gradient projection in closed form: the exact answer where every constraint is an equality.

    d = Pg + J⁺b,   P = I − Jᵀ(JJᵀ)⁻¹J,   Jᵀμ = d − g

by an orthonormal basis of the unit rows, compiled. Source: Rosen 1960; eq. 7–10 of the paper (λ = −μ).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch
from ..settings import CheckedSettings
from .geometry import takes_geometry
from .kernels import compiled_kernels, solve_single, solve_stacked


@takes_geometry
@dataclass(frozen=True, kw_only=True)
class Rosen(CheckedSettings):
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

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction; UNSUPPORTED, with zeros, where an inequality is switched on."""
        return solve_single(compiled_kernels().solve_tangent, problem, self.tolerance)

    def solve_batch(self, problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
        """B problems of one shape in one compiled call, each exactly as `solve` solves it."""
        return solve_stacked(compiled_kernels().solve_tangent_batch, problems, self.tolerance)
