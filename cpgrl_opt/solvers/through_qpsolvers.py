"""QP back ends through qpsolvers, each with its own names for limits, tolerance and silence.

min ½xᵀx − cᵀx   s.t.   −A_I x ≤ −b_I,   A_E x = b_E
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ..direction import Direction, Status
from ..problem import DirectionProblem
from .base import SmallSolver
from .interface import MissingPackageError
from .library_calls import LIBRARY_CALLS, LibraryCall, LibraryError
from .packages import has_package, require_import
from .small_problem import SmallAnswer, SmallProblem


@dataclass(frozen=True)
class BackEndFacts:
    """What one back end of qpsolvers is called, where it comes from, and which options keep it in bounds.

    options(tolerance, iteration limit, time limit in s) → keyword arguments of its solve function.
    """

    package: str
    extra: str
    source: str
    guarantee: str
    is_sparse: bool
    default_iteration_limit: int
    options: Callable[[float, int, float], dict[str, Any]]


def _quadprog(tolerance: float, iterations: int, seconds: float) -> dict[str, Any]:  # noqa: ARG001 - it has none
    return {}


def _daqp(tolerance: float, iterations: int, seconds: float) -> dict[str, Any]:
    return {
        "primal_tol": 1e-3 * tolerance,
        "dual_tol": 1e-3 * tolerance,
        "iter_limit": iterations,
        "time_limit": seconds,
        "sing_tol": 1e-20,  # rows 1e-9 rad apart are two rows; the default joins what is closer than 1e-5
        "zero_tol": 1e-14,
    }


def _piqp(tolerance: float, iterations: int, seconds: float) -> dict[str, Any]:  # noqa: ARG001 - no time limit
    return {
        "eps_abs": 1e-2 * tolerance,
        "eps_rel": 0.0,
        "eps_duality_gap_abs": 1e-2 * tolerance,
        "eps_duality_gap_rel": 0.0,
        "max_iter": iterations,
    }


def _proxqp(tolerance: float, iterations: int, seconds: float) -> dict[str, Any]:  # noqa: ARG001 - no time limit
    return {"eps_abs": 1e-1 * tolerance, "eps_rel": 0.0, "max_iter": iterations}


def _clarabel(tolerance: float, iterations: int, seconds: float) -> dict[str, Any]:
    gap = 1e-2 * tolerance
    return {
        "tol_feas": gap,
        "tol_gap_abs": gap,
        "tol_gap_rel": gap,
        "max_iter": iterations,
        "time_limit": seconds,
        "max_threads": 1,
    }


def _highs(tolerance: float, iterations: int, seconds: float) -> dict[str, Any]:
    feasibility = max(1e-10, 1e-2 * tolerance)  # the least that HiGHS takes
    return {
        "output_flag": False,
        "primal_feasibility_tolerance": feasibility,
        "dual_feasibility_tolerance": feasibility,
        "qp_regularization_value": 0.0,
        "qp_iteration_limit": iterations,
        "time_limit": seconds,
        "threads": 1,
    }


def _scs(tolerance: float, iterations: int, seconds: float) -> dict[str, Any]:
    return {
        "eps_abs": 1e-1 * tolerance,
        "eps_rel": 0.0,
        "eps_infeas": 1e-9,
        "max_iters": iterations,
        "time_limit_secs": seconds,
        # Where τ of its embedding sinks to 0 in a long run, SCS prints "ERROR: could not determine problem status",
        # and no option forbids it. With one metric throughout and no extrapolation the iteration is nonexpansive and
        # τ stays; the rows have length 1, for which 10 converges about as fast as the scale that SCS would adapt.
        "adaptive_scale": False,
        "acceleration_lookback": 0,
        "scale": 10.0,
    }


BACK_ENDS: Mapping[str, BackEndFacts] = MappingProxyType(
    {
        "quadprog": BackEndFacts(
            "quadprog",
            "gpl",
            "Goldfarb & Idnani 1983",
            "dual active set, certified or UNCERTIFIED",
            False,
            0,
            _quadprog,
        ),
        "daqp": BackEndFacts(
            "daqp", "solvers", "Arnström et al. 2022", "dual active set, certified or UNCERTIFIED", False, 1000, _daqp
        ),
        "piqp": BackEndFacts("piqp", "solvers", "Schwan et al. 2023", "interior point, polished", False, 250, _piqp),
        "proxqp": BackEndFacts(
            "proxsuite", "solvers", "Bambade et al. 2022", "augmented Lagrangian, polished", False, 200, _proxqp
        ),
        "clarabel": BackEndFacts(
            "clarabel", "solvers", "Goulart & Chen 2024", "interior point, polished", True, 200, _clarabel
        ),
        "highs": BackEndFacts(
            "highspy", "solvers", "Huangfu & Hall 2018", "primal active set, polished", True, 1000, _highs
        ),
        "scs": BackEndFacts("scs", "solvers", "O'Donoghue 2021", "first order (ADMM), polished", True, 20000, _scs),
    }
)


@dataclass(frozen=True)
class QPSolversBackend(SmallSolver):
    """One of qpsolvers' back ends on the small problem.

    name: a key of BACK_ENDS. tolerance: the worst KKT residual of an OPTIMAL answer; polish: project once more onto
    the face found. iteration_limit: of the back end, its own kind of iteration (None: the back end's in BACK_ENDS);
    time_limit: s. PIQP and ProxQP have none, so that only iteration_limit ends them; quadprog has neither, and nothing
    but its own finite method ends it. options: further keyword arguments for the back end, which win.
    """

    name: str
    tolerance: float = field(default=1e-8, kw_only=True)
    polish: bool = field(default=True, kw_only=True)
    iteration_limit: int | None = field(default=None, kw_only=True)
    time_limit: float = field(default=2.0, kw_only=True)
    options: Mapping[str, Any] = field(default_factory=dict, kw_only=True, hash=False)

    also_needs: ClassVar[tuple[str, ...]] = ("qpsolvers",)

    def __post_init__(self) -> None:
        """A wrong name is refused here, not at the first problem."""
        super().__post_init__()
        if self.name not in BACK_ENDS:
            raise ValueError(f"name should be one of {', '.join(BACK_ENDS)}; found {self.name!r}")

    @property
    def package(self) -> str:
        """The package to import."""
        return BACK_ENDS[self.name].package

    @property
    def source(self) -> str:
        """Where the method comes from."""
        return BACK_ENDS[self.name].source

    @property
    def guarantee(self) -> str:
        """What the method promises."""
        return BACK_ENDS[self.name].guarantee

    def solve_rows(self, problem: DirectionProblem) -> Direction:
        """The certified direction; see `Status`. Raises MissingPackageError, UnusablePackageError."""
        if not (has_package(self.package) and has_package("qpsolvers")):
            raise MissingPackageError(self.name, self.package, BACK_ENDS[self.name].extra)
        require_import(self.name, "qpsolvers")
        require_import(self.name, self.package)  # qpsolvers takes every ImportError for "not installed"
        return super().solve_rows(problem)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """The back end's x and μ."""
        facts = BACK_ENDS[self.name]
        limit = facts.default_iteration_limit if self.iteration_limit is None else self.iteration_limit
        options = {**facts.options(self.tolerance, limit, self.time_limit), **self.options}
        call: LibraryCall = LIBRARY_CALLS.get(self.name, partial(call_through_qpsolvers, self.name))
        try:
            return answer_of(small, call(small, options))
        except LibraryError:
            return SmallAnswer(None, None, failure=Status.NUMERICAL_ERROR)


def call_through_qpsolvers(name: str, small: SmallProblem, options: dict[str, Any]) -> Any:
    """qpsolvers' Solution, of a back end about which qpsolvers says nothing; LibraryError where it raises its own."""
    from qpsolvers import ProblemError, SolverError, solve_problem

    program = quadratic_program(small, BACK_ENDS[name].is_sparse)
    try:
        return solve_problem(program, name, verbose=False, **options)
    except (ProblemError, SolverError) as error:
        raise LibraryError(str(error)) from error


def quadratic_program(small: SmallProblem, is_sparse: bool) -> Any:
    """The problem as qpsolvers states it."""
    from qpsolvers import Problem
    from scipy.sparse import csc_matrix

    matrix = csc_matrix if is_sparse else np.ascontiguousarray
    equality, inequality = small.equality, ~small.equality
    G = h = A = b = None
    if inequality.any():
        G, h = matrix(-small.rows[inequality]), -small.bound[inequality]
    if equality.any():
        A, b = matrix(small.rows[equality]), small.bound[equality]
    return Problem(matrix(np.eye(len(small.center))), -small.center, G, h, A, b)


def answer_of(small: SmallProblem, solution: Any) -> SmallAnswer:
    """x, μ_I = z and μ_E = −y: qpsolvers' Lagrangian is that of Gx ≤ h and Ax = b."""
    verdict, iterations = _verdict(solution), _iterations(solution.extras)
    if solution.x is None:
        return SmallAnswer(None, None, iterations, verdict)
    multipliers = np.zeros(len(small.bound))
    for part, sign, values in ((~small.equality, 1.0, solution.z), (small.equality, -1.0, solution.y)):
        if values is not None and len(values) == int(part.sum()):
            multipliers[part] = sign * np.asarray(values, dtype=np.float64)
    point = np.asarray(solution.x, dtype=np.float64)
    if point.shape != small.center.shape:  # HiGHS without an answer gives an empty one
        return SmallAnswer(None, None, iterations, Status.NUMERICAL_ERROR)
    return SmallAnswer(point, multipliers, iterations, verdict)


def _verdict(solution: Any) -> Status | None:
    """The back end's own status where qpsolvers passes it on; one without answer or status means infeasible."""
    if solution.found:
        return None
    info = solution.extras.get("info")
    status = solution.extras.get("status", getattr(info, "status", None))
    if status is None:
        return Status.INFEASIBLE if solution.x is None else Status.UNCERTIFIED
    text = str(status).lower().replace("_", "")  # e.g. PIQP_MAX_ITER_REACHED, MaxIterations, PrimalInfeasible
    if "infeasible" in text:
        return Status.INFEASIBLE
    return Status.ITERATION_LIMIT if "maxiter" in text or "maxtime" in text else Status.UNCERTIFIED


def _iterations(extras: Any) -> int:
    """As the back end counts them; 0 where qpsolvers does not pass them on."""
    count = extras.get("iterations", extras.get("iter", getattr(extras.get("info"), "iter", 0)))
    return int(np.max(count))
