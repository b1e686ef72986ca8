"""OSQP directly: one workspace per shape, updated in place, warm-started only when asked to.

min ½xᵀx − cᵀx   s.t.   l ≤ Ax ≤ u,   u = l on E, u = ∞ on I
"""

from _thread import interrupt_main
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch, require_problem
from .base import SmallSolver
from .library_calls import failure_of, run_alone
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
        """A solver for problems with n parameters and m constraints; warm_start: from the last answer."""
        require_packages(self)
        return OSQPSession(self, n, m, warm_start=warm_start)

    def solve_batch(self, problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
        """B problems of one shape, one after the other in one session, each from a cold start."""
        stacked = ProblemBatch.stack(problems)
        _, m, n = stacked.jacobian.shape
        return self.session(n, m).solve_batch(stacked)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """ADMM's x and μ, from a workspace of its own."""
        return _run(_set_up(self, small))


class OSQPSession(SmallSolver):
    """OSQP's workspaces for problems of one shape, one for each shape that they are reduced to.

    With `warm_start` each problem starts at the last answer in its workspace.
    """

    def __init__(self, settings: OSQP, n: int, m: int, *, warm_start: bool = False) -> None:
        self.tolerance, self.polish = settings.tolerance, settings.polish
        self.settings, self.n, self.m, self.warm_start = settings, n, m, warm_start
        self._workspaces: dict[tuple[int, ...], Any] = {}

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction; ValueError unless the problem has the session's shape."""
        m, n = require_problem(problem).m, problem.n
        if (m, n) != (self.m, self.n):
            raise ValueError(
                f"problem should have m = {self.m} and n = {self.n} as its session; found m = {m}, n = {n}"
            )
        return super().solve(problem)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """ADMM's x and μ."""
        shape = small.rows.shape
        workspace = self._workspaces.get(shape)
        if workspace is None:
            workspace = self._workspaces[shape] = _set_up(self.settings, small)
            return _run(workspace)
        workspace.update(**_numbers(small), Ax=small.rows.ravel(order="F"))
        if not self.warm_start:  # ADMM's adapted step size is state as well
            workspace.warm_start(x=np.zeros(shape[1]), y=np.zeros(shape[0]))
            workspace.update_settings(rho=self.settings.rho)
        return _run(workspace)


def _numbers(small: SmallProblem) -> dict[str, np.ndarray]:
    """q, l and u."""
    lower = np.clip(small.bound, -_LARGEST, _LARGEST)
    return {"q": -small.center, "l": lower, "u": np.where(small.equality, lower, np.inf)}


def _set_up(settings: OSQP, small: SmallProblem) -> Any:
    """A workspace with this problem in it."""
    import osqp
    from scipy.sparse import csc_matrix

    rows, columns = small.rows.shape
    # Every entry is stored, zeros too: later problems fill the same pattern.
    pattern = (np.tile(np.arange(rows), columns), np.arange(0, rows * columns + 1, rows))
    options = {
        "verbose": False, "polishing": False, "rho": settings.rho,
        "eps_abs": 1e-1 * settings.tolerance, "eps_rel": 0.0,
        "eps_prim_inf": 1e-10,  # coarser calls a far answer infeasible, finer takes 10⁴ steps for a weak one
        "max_iter": settings.iteration_limit, "time_limit": settings.time_limit,
        "adaptive_rho_interval": 25,  # counted in iterations: timed adaptation would change the answer
    }  # fmt: skip
    workspace = osqp.OSQP(algebra="builtin")
    A = csc_matrix((small.rows.ravel(order="F"), *pattern), shape=small.rows.shape)
    workspace.setup(csc_matrix(np.eye(columns)), A=A, **_numbers(small), **options)
    return workspace


def _run(workspace: Any) -> SmallAnswer:
    from osqp import SolverStatus

    result = run_alone(partial(workspace.solve, raise_error=False))
    if result.info.status_val == SolverStatus.OSQP_SIGINT:
        interrupt_main()
    failure, iterations = failure_of(result.info.status), int(result.info.iter)
    if result.x is None:
        return SmallAnswer(None, None, iterations, failure)
    return SmallAnswer(np.array(result.x, np.float64), -np.array(result.y), iterations, failure)
