"""Back ends called without qpsolvers, which warns of every status but "solved" and lets HiGHS print its banner.

min ½xᵀx − cᵀx   s.t.   −A_I x ≤ −b_I,   A_E x = b_E

Warnings and standard output belong to the process. To switch them off for one call would switch them off, or leave
them changed, for the other threads. So each library is asked in a way in which it has nothing to say.
"""

import os
import re
from _thread import interrupt_main
from collections.abc import Callable
from functools import partial
from threading import Lock
from typing import Any

import numpy as np

from ..arrays import Bool, Int
from ..direction import Status
from .small_problem import SmallAnswer, SmallProblem

_SCS_SIGINT = -5
_Order = Int[np.ndarray, "p"]
BROKEN = SmallAnswer(None, None, failure=Status.NUMERICAL_ERROR)  # the library gave up without an answer
# OSQP and SCS replace the handler of SIGINT while they run, and afterwards put back what they found. Two of them at
# once may find each other's handler: then Ctrl-C does nothing for the rest of the process.
_one_at_a_time = Lock()


def run_alone(run: Callable[[], Any]) -> Any:
    """`run()`, one call at a time in this process. A Ctrl-C that the library caught is for the caller to pass on."""
    with _one_at_a_time:
        return run()


def _renew_lock() -> None:
    """A child that is forked while another thread solves would wait for that thread for ever."""
    global _one_at_a_time
    _one_at_a_time = Lock()


if hasattr(os, "register_at_fork"):  # there is no fork on Windows
    os.register_at_fork(after_in_child=_renew_lock)


def call_quadprog(options: dict[str, Any], small: SmallProblem) -> SmallAnswer:
    """Goldfarb and Idnani's method; rows of C are ≥, the equalities first."""
    from quadprog import solve_qp

    matrix, bound, order, equalities = _stack(small, small.equality)
    hessian = np.eye(len(small.center))
    try:
        x, _, _, iterations, duals, _ = solve_qp(hessian, small.center, -matrix.T, -bound, equalities, **options)
    except ValueError as error:
        if "no solution" in str(error):
            return SmallAnswer(None, None, failure=Status.INFEASIBLE)  # the referee looks for the proof
        return BROKEN  # dependent equalities, which it takes for an indefinite Hessian
    return _answer(small, order, x, duals, None, int(np.max(iterations)))


def call_clarabel(options: dict[str, Any], small: SmallProblem) -> SmallAnswer:
    """A cone of zeros for E, then one of non-negative slacks for I."""
    import clarabel
    from scipy.sparse import csc_matrix

    matrix, bound, order, equalities = _stack(small, small.equality)
    settings = clarabel.DefaultSettings()
    for name, value in {"verbose": False, **options}.items():
        setattr(settings, name, value)
    cones = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(len(bound) - equalities)]
    identity = csc_matrix(np.eye(len(small.center)))
    try:
        solver = clarabel.DefaultSolver(identity, -small.center, csc_matrix(matrix), bound, cones, settings)
    except Exception:  # it names no class of its own
        return BROKEN
    result = solver.solve()
    return _answer(small, order, result.x, np.array(result.z), failure_of(result.status))


def call_scs(options: dict[str, Any], small: SmallProblem) -> SmallAnswer:
    """The zero cone for E, then the positive cone for I."""
    import scs
    from scipy.sparse import csc_matrix

    matrix, bound, order, equalities = _stack(small, small.equality)
    data = {"P": csc_matrix(np.eye(len(small.center))), "c": -small.center, "A": csc_matrix(matrix), "b": bound}
    cone = {"z": equalities, "l": len(bound) - equalities}
    result = run_alone(partial(scs.solve, data, cone, **{"verbose": False, **options}))
    info = result["info"]
    if info["status_val"] == _SCS_SIGINT:
        interrupt_main()
    return _answer(small, order, result["x"], result["y"], failure_of(info["status"]), info["iter"])


def call_highs(options: dict[str, Any], small: SmallProblem) -> SmallAnswer:
    """HiGHS in a thread of its own.

    HiGHS keeps one pool of workers for each thread that calls it, as large as the first call asked for. Later calls
    that ask for another size (`threads`) end in an error. In a thread of our own we neither meet the caller's pool nor
    leave ours to the caller.
    """
    from concurrent.futures import ThreadPoolExecutor

    from highspy import HessianFormat, HighsModelStatus, MatrixFormat, ObjSense

    # The base class: what highspy.Highs adds are callbacks, and installing those prints the banner before any option.
    from highspy._core import _Highs
    from scipy.sparse import csc_matrix

    solver = _Highs()
    for name, value in {"output_flag": False, **options}.items():
        solver.setOptionValue(name, value)
    matrix, bound, order, _ = _stack(small, ~small.equality)
    A, n, lower = csc_matrix(matrix), len(small.center), np.where(small.equality[order], bound, -np.inf)
    free, starts = np.full(n, np.inf), np.arange(n + 1, dtype=np.int32)  # no limits on x; a diagonal Hessian
    solver.passModel(
        n, len(bound), A.nnz, n, int(MatrixFormat.kColwise), int(HessianFormat.kTriangular), int(ObjSense.kMinimize),
        0.0, -small.center, -free, free, lower, bound, A.indptr, A.indices, A.data,
        starts, starts[:-1], np.ones(n), np.zeros(n, np.int32),
    )  # fmt: skip
    with ThreadPoolExecutor(max_workers=1) as own_thread:
        own_thread.submit(solver.run).result()
    result = solver.getSolution()
    failure = None if solver.getModelStatus() == HighsModelStatus.kOptimal else Status.UNCERTIFIED
    return _answer(small, order, result.col_value, -np.array(result.row_dual), failure)


def call_through_qpsolvers(name: str, options: dict[str, Any], small: SmallProblem) -> SmallAnswer:
    """A back end about which qpsolvers says nothing."""
    from qpsolvers import ProblemError, SolverError, solve_problem

    try:
        return answer_of(small, solve_problem(quadratic_program(small), name, verbose=False, **options))
    except (ProblemError, SolverError):
        return BROKEN


def quadratic_program(small: SmallProblem, matrix: Callable[..., Any] = np.ascontiguousarray) -> Any:
    """The problem as qpsolvers states it; matrix: the kind of matrices that the back end takes."""
    from qpsolvers import Problem

    equality, inequality = small.equality, ~small.equality
    G = h = A = b = None
    if inequality.any():
        G, h = matrix(-small.rows[inequality]), -small.bound[inequality]
    if equality.any():
        A, b = matrix(small.rows[equality]), small.bound[equality]
    return Problem(matrix(np.eye(len(small.center))), -small.center, G, h, A, b)


def answer_of(small: SmallProblem, solution: Any) -> SmallAnswer:
    """What qpsolvers' Solution says: x, z of I and y of E."""
    extras = solution.extras
    info = extras.get("info")
    iterations = int(np.max(extras.get("iterations", extras.get("iter", getattr(info, "iter", 0)))))
    unsaid = "infeasible" if solution.x is None else "unknown"
    failure = None if solution.found else failure_of(extras.get("status", getattr(info, "status", unsaid)))
    if solution.x is None:
        return SmallAnswer(None, None, iterations, failure)
    order = np.argsort(small.equality, kind="stable")
    return _answer(small, order, solution.x, np.concatenate((solution.z, solution.y)), failure, iterations)


def failure_of(status: object) -> Status | None:
    """A library's own status in our terms, e.g. PIQP_MAX_ITER_REACHED, MaxIterations, PrimalInfeasible, user_limit.

    None where it claims to have solved the problem.
    """
    text = str(status).lower().replace("_", "")
    if text in ("solved", "optimal"):
        return None
    if "infeasible" in text:
        return Status.INFEASIBLE
    return Status.ITERATION_LIMIT if re.search("max.*iter|limit|maxtime", text) else Status.UNCERTIFIED


def _stack(small: SmallProblem, first: Bool[np.ndarray, "p"]) -> tuple[np.ndarray, np.ndarray, _Order, int]:
    """A_E and −A_I, b_E and −b_I, rows where `first` is True above the others; their order, and how many are first."""
    order = np.argsort(~first, kind="stable")
    sign = np.where(small.equality[order], 1.0, -1.0)
    return sign[:, None] * small.rows[order], sign * small.bound[order], order, int(first.sum())


def _answer(
    small: SmallProblem, order: _Order, x: Any, duals: np.ndarray, failure: Status | None, iterations: int = 0
) -> SmallAnswer:
    """x and μ of the duals in this order: μ_I = z and μ_E = −y, those of −A_I x ≤ −b_I and A_E x = b_E."""
    point = np.asarray(x, dtype=np.float64)
    if point.shape != small.center.shape:  # HiGHS without an answer gives an empty one
        return SmallAnswer(None, None, iterations, Status.NUMERICAL_ERROR)
    multipliers = np.zeros(len(order))
    multipliers[order] = np.where(small.equality[order], -1.0, 1.0) * duals
    return SmallAnswer(point, multipliers, iterations, failure)
