"""OSQP directly: one workspace per shape, updated in place, warm-started only when asked to.

min ½xᵀx − cᵀx   s.t.   l ≤ Ax ≤ u,   u = l on E, u = ∞ on I
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from ..direction import Direction, DirectionBatch, Status
from ..problem import DirectionProblem, ProblemBatch
from .base import SmallSolver
from .interrupts import run_alone
from .packages import require_packages
from .small_problem import SmallAnswer, SmallProblem

# OSQP's infinity is 1e30; what is asked for beyond this is out of reach in units where numbers are about 1.
_LARGEST = 1e28


@dataclass(frozen=True, kw_only=True)
class OSQP(SmallSolver):
    """Operator splitting on the small problem, then our polishing.

    tolerance: the worst KKT residual of an OPTIMAL answer; polish: project once more onto the face found.
    iteration_limit: ADMM steps; time_limit: s; rho: first step size of ADMM.
    """

    tolerance: float = 1e-8
    polish: bool = True
    iteration_limit: int = 10_000
    time_limit: float = 2.0
    rho: float = 0.1

    package: ClassVar[str] = "osqp"
    source: ClassVar[str] = "Stellato et al. 2020"
    guarantee: ClassVar[str] = "first order (ADMM), polished"

    def session(self, n: int, m: int, *, warm_start: bool = False) -> "OSQPSession":
        """A workspace for problems with n parameters and m constraints; warm_start: from the last answer."""
        require_packages(self)
        return OSQPSession(self, n, m, warm_start=warm_start)

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction from a workspace of its own; see `Status`. Raises MissingPackageError."""
        if problem.n == 0:  # gradients that are an object of somebody's, who did not say how long: by its span
            return super().solve(problem)
        return self.session(problem.n, problem.m).solve(problem)

    def solve_batch(self, problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
        """B problems of one shape, one after the other in one workspace, each from a cold start."""
        stacked = ProblemBatch.stack(problems)
        _, m, n = stacked.jacobian.shape
        return self.session(n, m).solve_batch(stacked)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """ADMM's x and μ, from a workspace of its own."""
        m, k = small.rows.shape
        return self.session(k, m).solve_small(small)


class OSQPSession(SmallSolver):
    """OSQP's workspace for one shape. With `warm_start` each problem starts at the last one's answer.

    Problems that lose rows or coordinates on the way here are filled up with zeros, so that the pattern stays.
    """

    def __init__(self, settings: OSQP, n: int, m: int, *, warm_start: bool = False) -> None:
        self.tolerance, self.polish = settings.tolerance, settings.polish
        self.settings, self.n, self.m, self.warm_start = settings, n, m, warm_start
        self._workspace: Any = None

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction; ValueError unless the problem has the session's shape."""
        if (problem.m, problem.n) != (self.m, self.n):
            raise ValueError(
                f"problem should have m = {self.m} and n = {self.n} as its session; "
                f"found m = {problem.m}, n = {problem.n}"
            )
        return super().solve(problem)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """ADMM's x and μ."""
        from osqp import SolverStatus

        count, k = small.rows.shape
        A, q = np.zeros((self.m, min(self.n, self.m + 1))), np.zeros(min(self.n, self.m + 1))
        A[:count, :k], q[:k] = small.rows, -small.center
        lower, upper = np.full(self.m, -np.inf), np.full(self.m, np.inf)
        lower[:count] = np.clip(small.bound, -_LARGEST, _LARGEST)
        upper[:count][small.equality] = np.clip(small.bound[small.equality], -_LARGEST, _LARGEST)
        self._load(A, q, lower, upper)
        solve = partial(self._workspace.solve, raise_error=False)
        result = run_alone(solve, lambda result: result.info.status_val == SolverStatus.OSQP_SIGINT)
        failure, iterations = verdict_of(result.info.status_val), int(result.info.iter)
        if result.x is None:
            return SmallAnswer(None, None, iterations, failure)
        return SmallAnswer(np.array(result.x[:k], np.float64), -np.array(result.y[:count]), iterations, failure)

    def _load(self, A: np.ndarray, q: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
        if self._workspace is None:
            self._workspace = _workspace(self.settings, A, q, lower, upper)
            return
        self._workspace.update(q=q, l=lower, u=upper, Ax=A.ravel(order="F"))
        if not self.warm_start:  # ADMM's adapted step size is state as well
            self._workspace.warm_start(x=np.zeros(len(q)), y=np.zeros(len(lower)))
            self._workspace.update_settings(rho=self.settings.rho)


def verdict_of(status_value: int) -> Status | None:
    """OSQP's verdict in our terms; None where it claims to have solved the problem."""
    from osqp import SolverStatus

    failures = {
        SolverStatus.OSQP_SOLVED: None,
        SolverStatus.OSQP_SOLVED_INACCURATE: Status.UNCERTIFIED,
        SolverStatus.OSQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
        SolverStatus.OSQP_PRIMAL_INFEASIBLE_INACCURATE: Status.INFEASIBLE,
        SolverStatus.OSQP_MAX_ITER_REACHED: Status.ITERATION_LIMIT,
        SolverStatus.OSQP_TIME_LIMIT_REACHED: Status.ITERATION_LIMIT,
    }
    return failures.get(SolverStatus(status_value), Status.NUMERICAL_ERROR)


def _workspace(settings: OSQP, A: np.ndarray, q: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Any:
    import osqp
    from scipy.sparse import csc_matrix

    rows, columns = A.shape
    # Every entry is stored, zeros too: later problems fill the same pattern.
    pattern = (np.tile(np.arange(rows), columns), np.arange(0, rows * columns + 1, rows))
    stored = csc_matrix((A.ravel(order="F"), *pattern), shape=A.shape)
    options = {
        "verbose": False, "polishing": False, "rho": settings.rho,
        "eps_abs": 1e-1 * settings.tolerance, "eps_rel": 0.0,
        "eps_prim_inf": 1e-10,  # coarser calls a far answer infeasible, finer takes 10⁴ steps for a weak one
        "max_iter": settings.iteration_limit, "time_limit": settings.time_limit,
        "adaptive_rho_interval": 25,  # counted in iterations: timed adaptation would change the answer
    }  # fmt: skip
    workspace = osqp.OSQP(algebra="builtin")
    workspace.setup(csc_matrix(np.eye(columns)), q, stored, lower, upper, **options)
    return workspace
