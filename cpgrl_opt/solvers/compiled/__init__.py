"""The compiled core: exact projections onto cones and tangent faces, one problem or B problems of one shape.

    min_d ½‖d − g‖²   s.t.   Jᵢ d ≥ bᵢ (i ∈ I),   Jᵢ d = bᵢ (i ∈ E)

Signatures (C-contiguous float64, `equality` bool; inputs may be read-only; nothing is checked but that NaN and
overflow end as NUMERICAL_ERROR: `DirectionProblem` has validated them):

    solve_cone(gradient (n,), jacobian (m, n), bound (m,), equality (m,), tolerance, value_out (n,),
        multipliers_out (m,)) -> (status, iterations, worst residual)
    solve_cone_batch(gradient (B, n), jacobian (B, m, n), bound (B, m), equality (B, m), tolerance, value_out (B, n),
        multipliers_out (B, m), status_out (B,) int64, iterations_out (B,) int64)
    solve_tangent, solve_tangent_batch: the same arguments; UNSUPPORTED if an inequality is on (bound > −inf)

Statuses are the integers of `cpgrl_opt.Status`. `certificate.certify_stacked` is the referee, compiled. Importing
this package imports numba and compiles the kernels (once: they are cached on disk).

How a problem is solved, by file:

    _scaling            unit rows up to a power of two, nothing rounded; zero and switched-off rows
    _dual_active_set    Goldfarb & Idnani's method, in double precision, then refined, then lenient
    _basis              projections by an orthonormal basis of the active rows, refined where they nearly depend
    _certificate        the referee's residuals, which decide between OPTIMAL and another attempt
    _least_violation    what INFEASIBLE returns
    _projection         the order of it all; the entry point
"""

from pathlib import Path
from typing import Any

import numpy as np

from ._cache import forget_outdated_kernels

forget_outdated_kernels(Path(__file__).parent)

from ._projection import project_stacked  # noqa: E402 - loads the cache


def solve_cone(
    gradient: Any, jacobian: Any, bound: Any, equality: Any, tolerance: float, value_out: Any, multipliers_out: Any
) -> tuple[int, int, float]:
    """One problem with equalities and inequalities; see the package's head."""
    report = np.empty(3)
    project_stacked(False, gradient, jacobian, bound, equality, tolerance, value_out, multipliers_out, report)
    status, iterations, worst = report.tolist()
    return int(status), int(iterations), worst


def solve_tangent(
    gradient: Any, jacobian: Any, bound: Any, equality: Any, tolerance: float, value_out: Any, multipliers_out: Any
) -> tuple[int, int, float]:
    """One problem with equalities only; see the package's head."""
    report = np.empty(3)
    project_stacked(True, gradient, jacobian, bound, equality, tolerance, value_out, multipliers_out, report)
    status, iterations, worst = report.tolist()
    return int(status), int(iterations), worst


def solve_cone_batch(*arrays: Any) -> None:
    """B problems, each exactly as `solve_cone` solves it; arguments as the package's head lists them."""
    _solve_batch(False, *arrays)


def solve_tangent_batch(*arrays: Any) -> None:
    """B problems, each exactly as `solve_tangent` solves it; arguments as the package's head lists them."""
    _solve_batch(True, *arrays)


def _solve_batch(
    tangent: bool,
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
    count, m, n = jacobian.shape
    report = np.empty((count, 3))
    project_stacked(
        tangent,
        _flat(gradient),
        jacobian.reshape(count * m, n, copy=False),
        _flat(bound),
        _flat(equality),
        tolerance,
        _flat(value_out),
        _flat(multipliers_out),
        _flat(report),
    )
    status_out[:], iterations_out[:] = report[:, 0], report[:, 1]


def _flat(array: Any) -> Any:
    """The same numbers in one row; raises rather than copy, which would lose what is written."""
    return array.reshape(-1, copy=False)
