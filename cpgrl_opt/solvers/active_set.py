"""The default solver: the exact core, compiled.

    min ½‖d − g‖²   s.t.   Jᵢd ≥ bᵢ (i ∈ I),   Jᵢd = bᵢ (i ∈ E)

A direct pass by the Gram matrix where rows are well apart; else Goldfarb and Idnani's method on orthonormal rows. Both
judge their answers with the referee's formulas; `thorough` proves infeasibility.
"""

from dataclasses import dataclass
from typing import ClassVar

from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch
from .base import Solver
from .exact_core import climb, project, project_batch, solve_small_exactly
from .small_problem import SmallAnswer, SmallProblem


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
        """The certified direction, in one compiled call; in more where rows nearly depend."""
        return project(problem, self.tolerance)

    def solve_rows_batch(self, problems: ProblemBatch) -> DirectionBatch:
        """B problems in one compiled call, each exactly as `solve_rows` answers it."""
        return project_batch(problems, self.tolerance)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """The exact core, as the ball's search asks it."""
        return solve_small_exactly(small)

    def climb(self, problems: ProblemBatch) -> DirectionBatch:
        """The usual ones in one compiled call."""
        return climb(problems, self.tolerance)
