"""Back ends as a user would call them: the problem as it stands, their default settings, no polishing, no second look.

    min ½xᵀx − gᵀx   s.t.   Jᵢx ≥ bᵢ (i ∈ I),   Jᵢx = bᵢ (i ∈ E)

What they claim is passed on unchecked; the comparison's referee judges it, and so shows what our preparation buys.
"""

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

import numpy as np

from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..solvers.library_calls import BROKEN, answer_of, failure_of, quadratic_program
from ..solvers.small_problem import SmallAnswer, SmallProblem
from ..solvers.through_qpsolvers import BACK_ENDS

_SPARSE = ("clarabel", "highs", "scs")  # take sparse matrices only

RawSolve = Callable[[DirectionProblem], Direction]


def _through_qpsolvers(name: str, problem: DirectionProblem) -> Direction:
    from qpsolvers import ProblemError, SolverError, solve_problem
    from scipy.sparse import csc_matrix

    whole = SmallProblem(problem.gradient, problem.jacobian, problem.bound, problem.equality)  # nothing reduced
    try:
        program = quadratic_program(whole, csc_matrix) if name in _SPARSE else quadratic_program(whole)
        solution = solve_problem(program, name)
    except (ProblemError, SolverError):  # the library's way to decline
        return _claim(problem, BROKEN)
    return _claim(problem, answer_of(whole, solution))


def _osqp(problem: DirectionProblem) -> Direction:
    import osqp
    from scipy.sparse import csc_matrix

    upper = np.where(problem.equality, problem.bound, np.inf)
    workspace = osqp.OSQP()
    identity = csc_matrix(np.eye(problem.n))
    workspace.setup(identity, -problem.gradient, csc_matrix(problem.jacobian), problem.bound, upper, verbose=False)
    result = workspace.solve(raise_error=False)
    verdict = failure_of(result.info.status)
    certificate = result.prim_inf_cert if verdict == Status.INFEASIBLE else result.y
    return _claim(problem, SmallAnswer(result.x, -np.asarray(certificate), failure=verdict))


def _cvxpy(problem: DirectionProblem) -> Direction:
    import cvxpy

    d = cvxpy.Variable(problem.n)
    parts = []
    for mask, is_equality in ((~problem.equality, False), (problem.equality, True)):
        if mask.any():
            left, right = problem.jacobian[mask] @ d, problem.bound[mask]
            parts.append((mask, is_equality, left == right if is_equality else left >= right))
    objective = cvxpy.Minimize(0.5 * cvxpy.sum_squares(d - problem.gradient))
    statement = cvxpy.Problem(objective, [constraint for *_, constraint in parts])
    try:
        statement.solve()
    except cvxpy.SolverError:
        return _claim(problem, BROKEN)
    multipliers = np.zeros(problem.m)
    for mask, is_equality, constraint in parts:
        if constraint.dual_value is not None:
            multipliers[mask] = (-1.0 if is_equality else 1.0) * constraint.dual_value
    verdict = failure_of(statement.status)
    return _claim(problem, SmallAnswer(d.value, multipliers, failure=verdict))


def _nnls(problem: DirectionProblem) -> Direction:
    """LDP as printed: u = argmin_{u ≥ 0} ‖Eu − f‖, E = [Gᵀ; hᵀ], f = (0, …, 0, 1), z = −r/rₙ₊₁, with z = d − g.

    An equality is two inequalities. Lawson & Hanson, Solving Least Squares Problems, ch. 23.
    """
    from scipy.optimize import nnls

    E = np.flatnonzero(problem.equality)
    G = np.vstack([problem.jacobian, -problem.jacobian[E]])
    bound = np.append(problem.bound, -problem.bound[E])
    matrix = np.vstack([G.T, bound - G @ problem.gradient])
    target = np.zeros(problem.n + 1)
    target[-1] = 1.0
    try:
        u, distance = nnls(matrix, target)
    except (RuntimeError, ValueError):  # too many iterations; −∞ in b
        return _claim(problem, BROKEN)
    r = matrix @ u - target
    if distance <= np.finfo(np.float64).eps:  # ‖r‖ = 0 as printed
        return _claim(problem, SmallAnswer(None, _fold(u, E, problem.m), failure=Status.INFEASIBLE))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        point, weights = problem.gradient - r[:-1] / r[-1], _fold(-u / r[-1], E, problem.m)
    return _claim(problem, SmallAnswer(point, weights))


def _fold(weights: np.ndarray, equalities: np.ndarray, m: int) -> np.ndarray:
    """One signed multiplier for the two inequalities of an equality."""
    multipliers = weights[:m].copy()
    multipliers[equalities] -= weights[m:]
    return multipliers


def _claim(problem: DirectionProblem, answer: SmallAnswer) -> Direction:
    """The library's own claim; without a point or multipliers, zeros in their place."""
    point = np.zeros(problem.n) if answer.point is None else answer.point
    multipliers = np.zeros(problem.m) if answer.multipliers is None else answer.multipliers
    status = answer.failure
    if status is None:
        status = Status.NUMERICAL_ERROR if answer.point is None else Status.OPTIMAL
    return Direction(point, multipliers, status, answer.iterations)


RAW: Mapping[str, RawSolve] = MappingProxyType(
    {
        "nnls": _nnls,
        "osqp": _osqp,
        **{name: partial(_through_qpsolvers, name) for name in BACK_ENDS},
        "cvxpy": _cvxpy,
    }
)
