"""Back ends called without qpsolvers, which warns of every status but "solved" and lets HiGHS print its banner.

min ½xᵀx − cᵀx   s.t.   −A_I x ≤ −b_I,   A_E x = b_E

Warnings and standard output belong to the process. To switch them off for one call would switch them off, or leave
them changed, for the other threads. So each library is asked in a way in which it has nothing to say.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from .interrupts import run_alone
from .small_problem import SmallProblem

_SCS_SIGINT, _SCS_SOLVED = -5, 1


class LibraryError(Exception):
    """A library gave up without an answer."""


@dataclass(frozen=True, eq=False)
class LibraryAnswer:
    """What a library claims, with the names of qpsolvers' Solution: x, the duals y of E and z of I, and its status."""

    found: bool
    x: np.ndarray | None = None
    y: np.ndarray | None = None
    z: np.ndarray | None = None
    extras: Mapping[str, Any] = field(default_factory=dict)


def call_quadprog(small: SmallProblem, options: dict[str, Any]) -> LibraryAnswer:
    """Goldfarb and Idnani's method; rows of C are ≥, the equalities first."""
    from quadprog import solve_qp

    matrix, bound, equalities = _equalities_first(small)
    hessian = np.eye(len(small.center))
    try:
        x, _, _, iterations, duals, active = solve_qp(hessian, small.center, -matrix.T, -bound, equalities, **options)
    except ValueError as error:
        if "no solution" in str(error):
            return LibraryAnswer(found=False)  # no answer and no status: the referee looks for the proof
        raise LibraryError(str(error)) from error  # dependent equalities, which it takes for an indefinite Hessian
    extras = {"iact": active, "iterations": iterations}
    return LibraryAnswer(True, x, duals[:equalities], duals[equalities:], extras)


def call_clarabel(small: SmallProblem, options: dict[str, Any]) -> LibraryAnswer:
    """A cone of zeros for E, then one of non-negative slacks for I."""
    import clarabel
    from scipy.sparse import csc_matrix

    matrix, bound, equalities = _equalities_first(small)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    for name, value in options.items():
        setattr(settings, name, value)
    sizes = ((clarabel.ZeroConeT, equalities), (clarabel.NonnegativeConeT, len(bound) - equalities))
    cones = [cone(size) for cone, size in sizes if size > 0]
    identity = csc_matrix(np.eye(len(small.center)))
    try:
        solver = clarabel.DefaultSolver(identity, -small.center, csc_matrix(matrix), bound, cones, settings)
    except Exception as error:  # it names no class of its own
        raise LibraryError(str(error)) from error
    result = solver.solve()
    duals = np.array(result.z)
    is_solved = result.status == clarabel.SolverStatus.Solved
    return LibraryAnswer(
        is_solved, np.array(result.x), duals[:equalities], duals[equalities:], {"status": result.status}
    )


def call_scs(small: SmallProblem, options: dict[str, Any]) -> LibraryAnswer:
    """The zero cone for E, then the positive cone for I."""
    import scs
    from scipy.sparse import csc_matrix

    matrix, bound, equalities = _equalities_first(small)
    data = {"P": csc_matrix(np.eye(len(small.center))), "c": -small.center, "A": csc_matrix(matrix), "b": bound}
    sizes = {"z": equalities, "l": len(bound) - equalities}
    cone = {name: size for name, size in sizes.items() if size > 0}
    solve = partial(scs.solve, data, cone, **{"verbose": False, **options})
    result = run_alone(solve, lambda result: result["info"]["status_val"] == _SCS_SIGINT)
    info, duals = result["info"], result["y"]
    return LibraryAnswer(info["status_val"] == _SCS_SOLVED, result["x"], duals[:equalities], duals[equalities:], info)


def call_highs(small: SmallProblem, options: dict[str, Any]) -> LibraryAnswer:
    """HiGHS in a thread of its own.

    HiGHS keeps one pool of workers for each thread that calls it, as large as the first call asked for. Later calls
    that ask for another size (`threads`) end in an error. In a thread of our own we neither meet the caller's pool nor
    leave ours to the caller.
    """
    from concurrent.futures import ThreadPoolExecutor

    from highspy import HighsModelStatus

    # The base class: what highspy.Highs adds are callbacks, and installing those prints the banner before any option.
    from highspy._core import _Highs

    solver = _Highs()
    solver.setOptionValue("output_flag", False)
    for name, value in options.items():
        solver.setOptionValue(name, value)
    solver.passModel(_highs_model(small))
    with ThreadPoolExecutor(max_workers=1) as own_thread:
        own_thread.submit(solver.run).result()
    result = solver.getSolution()
    duals = -np.array(result.row_dual)
    is_solved = solver.getModelStatus() == HighsModelStatus.kOptimal
    of_inequalities = int((~small.equality).sum())
    return LibraryAnswer(is_solved, np.array(result.col_value), duals[of_inequalities:], duals[:of_inequalities])


def _highs_model(small: SmallProblem) -> Any:
    """lower ≤ Ax ≤ upper with the inequalities first; the lower triangle of the Hessian; no limits on x."""
    import highspy
    from scipy.sparse import csc_matrix

    inequality, center = ~small.equality, small.center
    rows = csc_matrix(np.vstack([-small.rows[inequality], small.rows[small.equality]]))
    unlimited = np.full(int(inequality.sum()), -highspy.kHighsInf)
    model, n = highspy.HighsModel(), len(center)
    lp, hessian = model.lp_, model.hessian_
    hessian.dim_, hessian.start_ = n, np.arange(n + 1, dtype=np.int32)
    hessian.index_, hessian.value_ = np.arange(n, dtype=np.int32), np.ones(n)
    lp.num_col_, lp.col_cost_ = n, -center
    lp.col_lower_, lp.col_upper_ = np.full(n, -highspy.kHighsInf), np.full(n, highspy.kHighsInf)
    lp.num_row_ = len(small.bound)
    lp.row_lower_ = np.concatenate([unlimited, small.bound[small.equality]])
    lp.row_upper_ = np.concatenate([-small.bound[inequality], small.bound[small.equality]])
    lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    lp.a_matrix_.num_row_, lp.a_matrix_.num_col_ = rows.shape
    lp.a_matrix_.start_, lp.a_matrix_.index_, lp.a_matrix_.value_ = rows.indptr, rows.indices, rows.data
    return model


def _equalities_first(small: SmallProblem) -> tuple[np.ndarray, np.ndarray, int]:
    """(A_E above −A_I, b_E above −b_I, how many equalities)."""
    equality = small.equality
    matrix = np.vstack([small.rows[equality], -small.rows[~equality]])
    bound = np.concatenate([small.bound[equality], -small.bound[~equality]])
    return matrix, bound, int(equality.sum())


LibraryCall = Callable[[SmallProblem, dict[str, Any]], Any]  # what `answer_of` takes

LIBRARY_CALLS: Mapping[str, LibraryCall] = MappingProxyType(
    {"quadprog": call_quadprog, "clarabel": call_clarabel, "scs": call_scs, "highs": call_highs}
)
