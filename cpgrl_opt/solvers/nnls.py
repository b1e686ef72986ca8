"""Least-distance programming through scipy.optimize.nnls: an exact method independent of the default solver's."""

from dataclasses import dataclass
from typing import ClassVar

from .base import SmallSolver
from .least_distance import least_distance
from .small_problem import SmallAnswer, SmallProblem


@dataclass(frozen=True, kw_only=True)
class NNLS(SmallSolver):
    """min ½‖d − g‖² s.t. Jd ≥ b as a nonnegative least-squares problem in m unknowns; equalities by elimination.

    tolerance: the worst KKT residual of an OPTIMAL answer; polish: project once more onto the face found.
    """

    tolerance: float = 1e-9
    polish: bool = True

    package: ClassVar[str] = "scipy"
    source: ClassVar[str] = "Lawson & Hanson 1974, ch. 23 (LDP)"
    guarantee: ClassVar[str] = "finite active-set method (scipy), certified or UNCERTIFIED"

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """x and μ by scipy's NNLS."""
        return least_distance(small)
