"""The compiled core: exact projections onto cones and tangent faces, one problem or B problems of one shape.

    min_d ½‖d − g‖²   s.t.   Jᵢ d ≥ bᵢ (i ∈ I),   Jᵢ d = bᵢ (i ∈ E)

Signatures (C-contiguous float64, `equality` bool; inputs may be read-only; nothing is checked but that NaN and
overflow end as NUMERICAL_ERROR: `DirectionProblem` has validated them):

    solve_cone(gradient (n,), jacobian (m, n), bound (m,), equality (m,), tolerance, value_out (n,), multipliers_out (m,))
        -> (status, iterations, worst residual)
    solve_cone_batch(gradient (B, n), jacobian (B, m, n), bound (B, m), equality (B, m), tolerance, value_out (B, n),
        multipliers_out (B, m), status_out (B,) int64, iterations_out (B,) int64)
    solve_tangent, solve_tangent_batch: the same arguments; UNSUPPORTED if an inequality is on (bound > −inf)

Statuses are the integers of `cpgrl_opt.Status`. Importing this package imports numba.
"""

from typing import Any

import numpy as np

from ._projection import project_batch


def solve_cone(
    gradient: Any, jacobian: Any, bound: Any, equality: Any, tolerance: float, value_out: Any, multipliers_out: Any
) -> tuple[int, int, float]:
    """One problem with equalities and inequalities; see the package's head."""
    return _solve_one(False, gradient, jacobian, bound, equality, tolerance, value_out, multipliers_out)


def solve_tangent(
    gradient: Any, jacobian: Any, bound: Any, equality: Any, tolerance: float, value_out: Any, multipliers_out: Any
) -> tuple[int, int, float]:
    """One problem with equalities only; see the package's head."""
    return _solve_one(True, gradient, jacobian, bound, equality, tolerance, value_out, multipliers_out)


def solve_cone_batch(
    gradient: Any,
    jacobian: Any,
    bound: Any,
    equality: Any,
    tolerance: float,
    value_out: Any,
    multipliers_out: Any,
    status_out: Any,
    iterations_out: Any,
) -> None:
    """B problems, each exactly as `solve_cone` solves it."""
    worst = np.empty(len(gradient))
    project_batch(
        False,
        gradient,
        jacobian,
        bound,
        equality,
        tolerance,
        value_out,
        multipliers_out,
        status_out,
        iterations_out,
        worst,
    )


def solve_tangent_batch(
    gradient: Any,
    jacobian: Any,
    bound: Any,
    equality: Any,
    tolerance: float,
    value_out: Any,
    multipliers_out: Any,
    status_out: Any,
    iterations_out: Any,
) -> None:
    """B problems, each exactly as `solve_tangent` solves it."""
    worst = np.empty(len(gradient))
    project_batch(
        True,
        gradient,
        jacobian,
        bound,
        equality,
        tolerance,
        value_out,
        multipliers_out,
        status_out,
        iterations_out,
        worst,
    )


def _solve_one(
    tangent: bool,
    gradient: Any,
    jacobian: Any,
    bound: Any,
    equality: Any,
    tolerance: float,
    value_out: Any,
    multipliers_out: Any,
) -> tuple[int, int, float]:
    outcome, worst = np.empty((2, 1), np.int64), np.empty(1)
    project_batch(
        tangent,
        gradient[None],
        jacobian[None],
        bound[None],
        equality[None],
        tolerance,
        value_out[None],
        multipliers_out[None],
        outcome[0],
        outcome[1],
        worst,
    )
    return int(outcome[0, 0]), int(outcome[1, 0]), float(worst[0])
