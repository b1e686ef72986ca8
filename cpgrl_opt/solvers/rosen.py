"""Rosen's gradient projection in closed form: the exact answer where every constraint is an equality.

    d = Pg + J⁺b,   P = I − Jᵀ(JJᵀ)⁻¹J,   Jᵀμ = d − g

by an orthonormal basis of the unit rows, compiled. Source: Rosen 1960; eq. 7–10 of the paper (λ = −μ).
"""

from dataclasses import dataclass
from math import inf
from typing import ClassVar

from ..problem import DirectionProblem
from .base import ExactSolver


@dataclass(frozen=True, kw_only=True)
class Rosen(ExactSolver):
    """The paper's tangent direction: rank-revealing on unit rows, equalities only.

    tolerance: the worst KKT residual of an OPTIMAL answer.
    """

    tolerance: float = 1e-9

    tangent: ClassVar[bool] = True
    package: ClassVar[str] = "numba"
    source: ClassVar[str] = "Rosen 1960; eq. 7–10 of the paper"
    guarantee: ClassVar[str] = "exact: closed form, equalities only; compiled, batched"

    def supports(self, problem: DirectionProblem) -> bool:
        """Equalities, and inequalities that are switched off (b = −inf)."""
        return bool((problem.equality | (problem.bound == -inf)).all())
