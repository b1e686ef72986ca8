"""The problem as CVXPY states it, solved by CLARABEL: an independent modelling path, slow.

minimize ½‖x‖² − cᵀx   subject to   A_I x ≥ b_I,   A_E x = b_E        with A, b, c parameters (DPP)
"""

from dataclasses import dataclass
from functools import lru_cache
from threading import get_ident
from typing import Any, ClassVar

import numpy as np

from ..direction import Status
from .base import SmallSolver
from .library_calls import BROKEN, failure_of
from .packages import require_packages
from .small_problem import SmallAnswer, SmallProblem
from .through_qpsolvers import BACK_ENDS


@dataclass(frozen=True, kw_only=True)
class CVXPY(SmallSolver):
    """A parametrised CVXPY problem behind the pipeline, compiled once for each shape in each thread.

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

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """x and μ of CLARABEL, read from the statement's variable and dual variables."""
        equalities = int(small.equality.sum())
        shape = len(small.center), len(small.bound) - equalities, equalities
        x, center, parts, statement = statement_of(get_ident(), *shape)
        center.value = small.center
        for is_equality, A, b, _ in parts:
            chosen = small.equality == is_equality
            A.value, b.value = small.rows[chosen], small.bound[chosen]
        iterations = _solve(statement, BACK_ENDS["clarabel"].options(self))
        if iterations is None:
            require_packages(self)  # CLARABEL's too
            return BROKEN
        failure = failure_of(statement.status)
        if x.value is None:
            return SmallAnswer(None, None, iterations, failure or Status.NUMERICAL_ERROR)
        multipliers = np.zeros(len(small.bound))
        for is_equality, *_, constraint in parts:  # CVXPY's dual of Ax = b is signed as that of Ax ≤ b
            multipliers[small.equality == is_equality] = (-1.0 if is_equality else 1.0) * constraint.dual_value
        return SmallAnswer(np.array(x.value), multipliers, iterations, failure)


@lru_cache(maxsize=64)
def statement_of(thread: int, coordinates: int, inequalities: int, equalities: int) -> Any:  # noqa: ARG001 - one for each
    """x, c, (whether it is an equality, A, b, constraint) of each part, and the cvxpy.Problem of them."""
    import cvxpy

    x, center, parts = cvxpy.Variable(coordinates), cvxpy.Parameter(coordinates), []
    for is_equality, count in ((False, inequalities), (True, equalities)):
        if count > 0:
            A, b = cvxpy.Parameter((count, coordinates)), cvxpy.Parameter(count)
            parts.append((is_equality, A, b, A @ x == b if is_equality else A @ x >= b))
    objective = 0.5 * cvxpy.sum_squares(x) - center @ x
    return x, center, parts, cvxpy.Problem(cvxpy.Minimize(objective), [constraint for *_, constraint in parts])


def _solve(statement: Any, options: dict[str, Any]) -> int | None:
    """CLARABEL's answer in the variables of the statement, and its iterations; None where it has none.

    These are the steps of Problem.solve without its warning of an inaccurate answer, which the referee judges anyway:
    to switch that off would reach the whole process.
    """
    import cvxpy
    from cvxpy.settings import ERROR

    try:
        data, chain, inverse_data = statement.get_problem_data(cvxpy.CLARABEL, solver_opts=options)
        found = chain.solve_via_data(statement, data, warm_start=False, verbose=False, solver_opts=options)
        solution = chain.invert(found, inverse_data)
    except cvxpy.SolverError:
        return None
    if solution.status in ERROR:
        return None
    statement.unpack(solution)
    return int(solution.attr.get("num_iters") or 0)
