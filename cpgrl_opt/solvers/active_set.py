"""The default solver: a dual active-set method on orthonormalised unit rows, compiled.

    min ½‖d − g‖²   s.t.   Jᵢd ≥ bᵢ (i ∈ I),   Jᵢd = bᵢ (i ∈ E)

The kernel scales, solves, judges its own answer with the referee's formulas, and proves infeasibility; this file
only hands over arrays, since every microsecond here is a good part of the time of a whole solve.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..direction import Direction, DirectionBatch, Status
from ..problem import DirectionProblem, ProblemBatch
from .kernels import compiled_kernels, solve_stacked

_STATUSES = tuple(Status)


@dataclass(frozen=True, kw_only=True)
class ActiveSet:
    """Goldfarb & Idnani's dual method in the basis of the active rows. The default.

    tolerance: the worst KKT residual of an OPTIMAL answer; the method reaches 1e-12 wherever float64 allows it.
    """

    tolerance: float = 1e-9

    package: ClassVar[str] = "numba"
    source: ClassVar[str] = "Goldfarb & Idnani 1983"
    guarantee: ClassVar[str] = "exact: dual active set on orthonormal rows; compiled, batched"

    def supports(self, problem: DirectionProblem) -> bool:  # noqa: ARG002 - all of them
        """Equalities, cones and bounds."""
        return True

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction; see `Status`."""
        jacobian = problem.jacobian
        m, n = jacobian.shape
        value, multipliers = np.empty(n), np.empty(m)
        status, iterations, _ = compiled_kernels().solve_cone(
            problem.gradient, jacobian, problem.bound, problem.equality, self.tolerance, value, multipliers
        )
        return Direction(value, multipliers, _STATUSES[status], iterations)

    def solve_batch(self, problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
        """B problems of one shape in one compiled call, each exactly as `solve` solves it."""
        return solve_stacked(compiled_kernels().solve_cone_batch, problems, self.tolerance)
