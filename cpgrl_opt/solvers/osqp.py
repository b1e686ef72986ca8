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
from ..settings import CheckedSettings
from ..vectors import is_long
from .geometry import takes_geometry
from .interrupts import run_alone
from .packages import require_import, require_package
from .preparation import require_session_shape, solve_prepared
from .reduction import BackEndAnswer, ReducedProblem


@takes_geometry
@dataclass(frozen=True, kw_only=True)
class OSQP(CheckedSettings):
    """Operator splitting on the reduced problem, then our polishing.

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

    def supports(self, problem: DirectionProblem) -> bool:  # noqa: ARG002 - all of them
        """Equalities, cones and bounds."""
        return True

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction from a workspace of its own; see `Status`. Raises MissingPackageError."""
        return self.session(problem.n, problem.m).solve(problem)

    def solve_batch(self, problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
        """The directions of problems of one shape, one after the other in one workspace, each from a cold start."""
        first = problems[0]
        session = self.session(first.n, first.m)
        return DirectionBatch.stack([session.solve(problem) for problem in problems])

    def session(self, n: int, m: int, *, warm_start: bool = False) -> "OSQPSession":
        """A workspace for problems with n parameters and m constraints; warm_start: from the last answer."""
        require_package("osqp", "osqp", "solvers")
        require_import("osqp", "osqp")
        return OSQPSession(self, n, m, warm_start=warm_start)


@takes_geometry
class OSQPSession:
    """OSQP's workspace for one shape. With `warm_start` each problem starts at the last one's answer.

    Problems that lose rows or coordinates in the preparation are filled up with zeros, so that the pattern stays.
    """

    def __init__(self, settings: OSQP, n: int, m: int, *, warm_start: bool = False) -> None:
        self.settings = settings
        self.n, self.m = n, m
        self.warm_start = warm_start
        self._rows, self._coordinates = m, min(n, m + 1)
        self._workspace: Any = None

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction; ValueError unless the problem has the session's shape."""
        if not (is_long(self.m, self.n) and problem.n == 1 + self.m):  # a long problem comes in its own coordinates
            require_session_shape(problem, self.n, self.m)
        settings = self.settings
        return solve_prepared(problem, self._solve_reduced, tolerance=settings.tolerance, polish=settings.polish)

    def _solve_reduced(self, reduced: ReducedProblem) -> BackEndAnswer:
        count, k = reduced.rows.shape
        A = np.zeros((self._rows, self._coordinates))
        A[:count, :k] = reduced.rows
        q = np.zeros(self._coordinates)
        q[:k] = -reduced.center
        lower, upper = np.full(self._rows, -np.inf), np.full(self._rows, np.inf)
        lower[:count] = reduced.bound
        upper[:count][reduced.equality] = reduced.bound[reduced.equality]
        self._load(A, q, lower, upper)
        return self._run(count, k)

    def _load(self, A: np.ndarray, q: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
        if self._workspace is None:
            self._workspace = _workspace(self.settings, A, q, lower, upper)
            return
        self._workspace.update(q=q, l=lower, u=upper, Ax=A.ravel(order="F"))
        if not self.warm_start:  # ADMM's adapted step size is state as well
            self._workspace.warm_start(x=np.zeros(len(q)), y=np.zeros(len(lower)))
            self._workspace.update_settings(rho=self.settings.rho)

    def _run(self, count: int, k: int) -> BackEndAnswer:
        solve = partial(self._workspace.solve, raise_error=False)
        result = run_alone(solve, lambda result: is_interrupted(result.info.status_val))
        verdict = verdict_of(result.info.status_val)
        if result.x is None:
            return BackEndAnswer(None, None, int(result.info.iter), verdict)
        point = np.array(result.x[:k], dtype=np.float64)
        return BackEndAnswer(point, -np.array(result.y[:count]), int(result.info.iter), verdict)


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


def is_interrupted(status_value: int) -> bool:
    """Whether OSQP stopped at Ctrl-C, which it catches while it runs."""
    from osqp import SolverStatus

    return bool(status_value == SolverStatus.OSQP_SIGINT)


def _workspace(settings: OSQP, A: np.ndarray, q: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Any:
    import osqp
    from scipy.sparse import csc_matrix

    rows, columns = A.shape
    # Every entry is stored, zeros too: later problems fill the same pattern.
    pattern = (np.tile(np.arange(rows), columns), np.arange(0, rows * columns + 1, rows))
    stored = csc_matrix((A.ravel(order="F"), *pattern), shape=A.shape)
    workspace = osqp.OSQP(algebra="builtin")
    workspace.setup(
        csc_matrix(np.eye(columns)),
        q,
        stored,
        lower,
        upper,
        verbose=False,
        eps_abs=1e-1 * settings.tolerance,
        eps_rel=0.0,
        eps_prim_inf=1e-10,  # coarser calls a far answer infeasible, finer takes 10⁴ steps for a weak one
        max_iter=settings.iteration_limit,
        time_limit=settings.time_limit,
        rho=settings.rho,
        polishing=False,
        adaptive_rho_interval=25,  # counted in iterations: timed adaptation would change the answer
    )
    return workspace
