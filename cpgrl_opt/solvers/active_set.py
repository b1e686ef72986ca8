"""The default solver: a dual active-set method on orthonormalised unit rows, compiled.

    min ½‖d − g‖²   s.t.   Jᵢd ≥ bᵢ (i ∈ I),   Jᵢd = bᵢ (i ∈ E)

The kernel scales, solves, judges its own answer with the referee's formulas, and proves infeasibility.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch
from ..settings import CheckedSettings
from .geometry import takes_geometry
from .kernels import compiled_kernels, solve_single, solve_stacked


@takes_geometry
@dataclass(frozen=True, kw_only=True)
class ActiveSet(CheckedSettings):
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
        return solve_single(compiled_kernels().solve_cone, problem, self.tolerance)

    def solve_batch(self, problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
        """B problems of one shape in one compiled call, each exactly as `solve` solves it."""
        return solve_stacked(compiled_kernels().solve_cone_batch, problems, self.tolerance)
