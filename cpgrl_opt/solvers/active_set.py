"""The default solver: a dual active-set method on orthonormalised unit rows, compiled.

    min ½‖d − g‖²   s.t.   Jᵢd ≥ bᵢ (i ∈ I),   Jᵢd = bᵢ (i ∈ E)

The kernel scales, solves, judges its own answer with the referee's formulas, and proves infeasibility.
"""

from dataclasses import dataclass
from typing import ClassVar

from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch
from .base import Solver
from .exact_core import project, project_batch


@dataclass(frozen=True, kw_only=True)
class ActiveSet(Solver):
    """Goldfarb & Idnani's dual method in the basis of the active rows. The default.

    tolerance: the worst KKT residual of an OPTIMAL answer; the method reaches 1e-12 wherever float64 allows it.
    """

    tolerance: float = 1e-9

    is_exact: ClassVar[bool] = True
    package: ClassVar[str] = "numba"
    source: ClassVar[str] = "Goldfarb & Idnani 1983"
    guarantee: ClassVar[str] = "exact: dual active set on orthonormal rows; compiled, batched"

    def solve_rows(self, problem: DirectionProblem) -> Direction:
        """The certified direction in one compiled call."""
        return project(problem, self.tolerance)

    def solve_rows_batch(self, problems: ProblemBatch) -> DirectionBatch:
        """B problems in one compiled call, each exactly as alone."""
        return project_batch(problems, self.tolerance)
