"""The problem as CVXPY states it, solved by CLARABEL: an independent modelling path, slow.

minimize ½‖x‖² − cᵀx   subject to   A_I x ≥ b_I,   A_E x = b_E        with A, b, c parameters (DPP)
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..direction import Status
from .base import Session, SolverWithSessions
from .cvxpy_call import solve_statement
from .packages import require_import, require_package
from .small_problem import SmallAnswer, SmallProblem


@dataclass(frozen=True, kw_only=True)
class CVXPY(SolverWithSessions):
    """A parametrised CVXPY problem behind the pipeline.

    tolerance: the worst KKT residual of an OPTIMAL answer; polish: project once more onto the face found.
    iteration_limit, time_limit (s): CLARABEL's.
    """

    tolerance: float = 1e-8
    polish: bool = True
    iteration_limit: int = 200
    time_limit: float = 2.0

    package: ClassVar[str] = "cvxpy"
    also_needs: ClassVar[tuple[str, ...]] = ("clarabel",)
    source: ClassVar[str] = "Diamond & Boyd 2016; Agrawal et al. 2019 (DPP)"
    guarantee: ClassVar[str] = "interior point (CLARABEL), polished; slow"

    def session(self, n: int, m: int, *, warm_start: bool = False) -> "CVXPYSession":  # noqa: ARG002
        """An object that keeps what it compiled for n parameters and m constraints.

        warm_start: as in other solvers' sessions; CLARABEL has none, so that no answer depends on the ones before.
        """
        for package in (self.package, *self.also_needs):
            require_package("cvxpy", package, "solvers")
            require_import("cvxpy", package)
        return CVXPYSession(self, n, m)


class CVXPYSession(Session):
    """CVXPY problems for one shape (n, m), compiled once for each number of coordinates and of equalities."""

    def __init__(self, settings: CVXPY, n: int, m: int) -> None:
        super().__init__(settings, n, m)
        self._options = _options(settings)
        self._compiled: dict[tuple[int, int, int], _Parametrised] = {}

    @property
    def compiled_shapes(self) -> int:
        """How many small shapes were compiled so far."""
        return len(self._compiled)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """CLARABEL's x and μ."""
        equalities = int(small.equality.sum())
        shape = (len(small.center), len(small.bound) - equalities, equalities)
        if shape not in self._compiled:
            self._compiled[shape] = _Parametrised(*shape)
        return self._compiled[shape].solve(small, self._options)


class _Parametrised:
    """One CVXPY problem; `solve` fills its parameters."""

    def __init__(self, coordinates: int, inequalities: int, equalities: int) -> None:
        import cvxpy

        self.x = cvxpy.Variable(coordinates)
        self.center = cvxpy.Parameter(coordinates)
        self.parts = []  # (is equality, rows, bound, constraint)
        for is_equality, count in ((False, inequalities), (True, equalities)):
            if count > 0:
                A, b = cvxpy.Parameter((count, coordinates)), cvxpy.Parameter(count)
                constraint = A @ self.x == b if is_equality else A @ self.x >= b
                self.parts.append((is_equality, A, b, constraint))
        objective = 0.5 * cvxpy.sum_squares(self.x) - self.center @ self.x
        self.problem = cvxpy.Problem(cvxpy.Minimize(objective), [constraint for *_, constraint in self.parts])

    def solve(self, small: SmallProblem, options: dict[str, Any]) -> SmallAnswer:
        """x and μ of CLARABEL, read from the problem's variable and dual variables."""
        import cvxpy

        self.center.value = small.center
        for is_equality, A, b, _ in self.parts:
            chosen = small.equality == is_equality
            A.value, b.value = small.rows[chosen], small.bound[chosen]
        try:
            solution = solve_statement(self.problem, options)
        except cvxpy.SolverError:
            return SmallAnswer(None, None, failure=Status.NUMERICAL_ERROR)
        return self._answer(small, int(solution.attr.get("num_iters") or 0))

    def _answer(self, small: SmallProblem, iterations: int) -> SmallAnswer:
        verdict = VERDICTS.get(self.problem.status, Status.UNCERTIFIED)
        if self.x.value is None:
            return SmallAnswer(None, None, iterations, verdict or Status.NUMERICAL_ERROR)
        multipliers = np.zeros(len(small.bound))
        for is_equality, *_, constraint in self.parts:
            # CVXPY's dual of Ax = b is signed as that of Ax ≤ b.
            sign = -1.0 if is_equality else 1.0
            multipliers[small.equality == is_equality] = sign * constraint.dual_value
        return SmallAnswer(np.array(self.x.value), multipliers, iterations, verdict)


def _options(settings: CVXPY) -> dict[str, Any]:
    """CLARABEL's own."""
    accuracy = 1e-2 * settings.tolerance
    return {
        "tol_feas": accuracy,
        "tol_gap_abs": accuracy,
        "tol_gap_rel": accuracy,
        "max_iter": settings.iteration_limit,
        "time_limit": settings.time_limit,
        "max_threads": 1,
    }


VERDICTS = {
    "optimal": None,
    "infeasible": Status.INFEASIBLE,
    "infeasible_inaccurate": Status.INFEASIBLE,
    "user_limit": Status.ITERATION_LIMIT,
}
