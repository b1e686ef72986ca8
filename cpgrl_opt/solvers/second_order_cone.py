"""Metric and radius as CVXPY states them, with nothing of `geometry` or `ball` in it: a second opinion.

    radius    maximize gᵀz  subject to  Jz ≥ b, = on E, ‖Sz‖ ≤ 1                 a second-order cone program
    metric    minimize ½‖Sz‖² − gᵀz  subject to  Jz ≥ b, = on E

with d = ℓDz in units ℓ of length, D = diag(M)^−½, and S = (DMD)^½ the symmetric root: no Cholesky factor and no
transposes. Where the ball is slack, an interior-point method ends in the middle of the best directions, and a second
program, minimize ‖Sz‖², looks for the shortest of them.
Source: Boyd & Vandenberghe, Convex Optimization, §4.4.2; Achiam et al. 2017 (the problem).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Bool, Float
from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..scaling import lengths, unit_rows
from .cvxpy_call import solve_statement

# κ below this part of ‖g‖/radius: the ball may be slack, and the best directions many.
_SLACK_BALL = 1e-7
# A multiplier above this, for ‖g‖ = 1, holds all of the best directions on its row.
_POSITIVE = 1e-6
_VERDICTS = {
    "optimal": Status.OPTIMAL,
    "optimal_inaccurate": Status.UNCERTIFIED,
    "infeasible": Status.INFEASIBLE,
    "infeasible_inaccurate": Status.INFEASIBLE,
    "user_limit": Status.ITERATION_LIMIT,
}


@dataclass(frozen=True, eq=False)
class _Stated:
    """The data of the module's head; S (n, n); strength = ‖Dg‖ in the problem's units, unit = ℓ."""

    gradient: Float[np.ndarray, "n"]
    rows: Float[np.ndarray, "m n"]
    bound: Float[np.ndarray, "m"]
    equality: Bool[np.ndarray, "m"]
    root: Float[np.ndarray, "n n"]
    in_ball: bool


def state_and_solve(problem: DirectionProblem, options: dict[str, Any]) -> Direction:
    """The modelled answer, its status CLARABEL's: nothing is certified here. INFEASIBLE comes without a direction."""
    sizes, root = _root(problem)
    rows = unit_rows(problem.jacobian / sizes)
    g = problem.gradient / sizes
    strength = float(lengths(g))
    bound = rows.per_length(problem.bound)
    on = (bound > -np.inf) & ~((rows.largest == 0.0) & (bound == 0.0))
    if (on & (rows.largest == 0.0)).any():  # a zero row that asks for something
        return Direction.nothing(problem.n, problem.m, Status.INFEASIBLE)
    demand = np.where(problem.equality, np.abs(bound), bound).max(initial=0.0, where=on)
    unit = problem.radius or max(strength, float(demand)) or 1.0
    gradient = g / ((strength if problem.radius else unit) or 1.0)
    stated = _Stated(
        gradient, rows.jacobian[on], bound[on] / unit, problem.equality[on], root, problem.radius is not None
    )
    z, weights, kappa, status = _solve(stated, options)
    force = strength if problem.radius else unit
    multipliers = np.zeros(problem.m)
    multipliers[on] = weights * force
    return Direction(z * unit / sizes, rows.per_length(multipliers), status, 0, kappa * force / unit)


def _root(problem: DirectionProblem) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n n"]]:
    """√diag(M) and S."""
    M = np.ones(problem.n) if problem.metric is None else problem.metric
    if M.ndim == 1:
        return np.sqrt(M), np.eye(problem.n)
    sizes = np.sqrt(M.diagonal())
    values, vectors = np.linalg.eigh(M / sizes / sizes[:, None])
    return sizes, (vectors * np.sqrt(values)) @ vectors.T


def _solve(
    stated: _Stated, options: dict[str, Any]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "m"], float, Status]:
    """z, μ, κ, status."""
    import cvxpy

    z = cvxpy.Variable(len(stated.gradient))
    length = cvxpy.norm(stated.root @ z)
    parts = _constraints(stated, z, stated.equality)
    ball = [length <= 1.0] if stated.in_ball else []
    climb = stated.gradient @ z
    goal = cvxpy.Maximize(climb) if stated.in_ball else cvxpy.Minimize(0.5 * cvxpy.sum_squares(stated.root @ z) - climb)
    status = _run(cvxpy.Problem(goal, [*(constraint for _, constraint in parts), *ball]), options)
    weights = np.zeros(len(stated.bound))
    if z.value is None:
        return np.zeros(len(stated.gradient)), weights, 0.0, status or Status.NUMERICAL_ERROR
    for chosen, constraint in parts:
        # CVXPY's dual of Jz = b is signed as that of Jz ≤ b, and those of a maximum as those of its negative.
        weights[chosen] = constraint.dual_value * (-1.0 if stated.equality[chosen].all() else 1.0)
    point, kappa = np.array(z.value), 0.0
    if stated.in_ball:
        kappa = float(ball[0].dual_value) / max(float(length.value), 1e-300)
        if kappa <= _SLACK_BALL and status in (Status.OPTIMAL, Status.UNCERTIFIED):
            shortest = cvxpy.Minimize(cvxpy.sum_squares(stated.root @ z))
            held = stated.equality | (weights > _POSITIVE)
            again = _run(cvxpy.Problem(shortest, [part for _, part in _constraints(stated, z, held)]), options)
            if again == Status.OPTIMAL and z.value is not None and float(length.value) <= 1.0:
                point, kappa = np.array(z.value), 0.0
    return point, weights, kappa, status


def _constraints(stated: _Stated, z: Any, equality: Bool[np.ndarray, "m"]) -> list[tuple[np.ndarray, Any]]:
    """(which rows, CVXPY's constraint) for inequalities and equalities, where there are any."""
    parts = []
    for chosen in (~equality, equality):
        if chosen.any():
            left, right = stated.rows[chosen] @ z, stated.bound[chosen]
            parts.append((chosen, left == right if chosen is equality else left >= right))
    return parts


def _run(program: Any, options: dict[str, Any]) -> Status:
    import cvxpy

    try:
        solve_statement(program, options)
    except cvxpy.SolverError:
        return Status.NUMERICAL_ERROR
    return _VERDICTS.get(program.status, Status.UNCERTIFIED)
