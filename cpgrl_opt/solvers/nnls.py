"""Least-distance programming through scipy.optimize.nnls: an exact method independent of the default solver's."""

from dataclasses import dataclass
from typing import ClassVar

from ..direction import Direction
from ..problem import DirectionProblem
from ..settings import CheckedSettings
from .geometry import takes_geometry
from .interface import LoopsOverBatches
from .least_distance import least_distance
from .preparation import solve_prepared


@takes_geometry
@dataclass(frozen=True, kw_only=True)
class NNLS(LoopsOverBatches, CheckedSettings):
    """min ½‖d − g‖² s.t. Jd ≥ b as a nonnegative least-squares problem in m unknowns; equalities by elimination.

    tolerance: the worst KKT residual of an OPTIMAL answer; polish: project once more onto the face found.
    """

    tolerance: float = 1e-9
    polish: bool = True

    package: ClassVar[str] = "scipy"
    source: ClassVar[str] = "Lawson & Hanson 1974, ch. 23 (LDP)"
    guarantee: ClassVar[str] = "finite active-set method (scipy), certified or UNCERTIFIED"

    def supports(self, problem: DirectionProblem) -> bool:  # noqa: ARG002 - all of them
        """Equalities, cones and bounds."""
        return True

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction; see `Status`."""
        return solve_prepared(problem, least_distance, tolerance=self.tolerance, polish=self.polish)
