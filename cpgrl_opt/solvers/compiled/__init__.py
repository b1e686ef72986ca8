"""The compiled core: exact projections onto cones and tangent faces, one problem or B problems of one shape.

    min_d ½‖d − g‖²   s.t.   Jᵢ d ≥ bᵢ (i ∈ I),   Jᵢ d = bᵢ (i ∈ E)

Signatures (C-contiguous float64, `equality` bool; inputs may be read-only; nothing is checked but that NaN and
overflow end as NUMERICAL_ERROR: `DirectionProblem` has validated them):

    solve_cone(gradient (n,), jacobian (m, n), bound (m,), equality (m,), tolerance, value_out (n,),
        multipliers_out (m,)) -> (status, iterations, worst residual)
    solve_cone_batch(gradient (B, n), jacobian (B, m, n), bound (B, m), equality (B, m), tolerance, value_out (B, n),
        multipliers_out (B, m), status_out (B,) int64, iterations_out (B,) int64)
    solve_tangent, solve_tangent_batch: the same arguments; UNSUPPORTED if an inequality is on (bound > −inf)

Statuses are the integers of `cpgrl_opt.Status`. A process's first sixteen problems are interpreted if they are small,
batches and all later ones compiled, to the same bits; compiled kernels are cached on disk. How a problem is solved, by
file:

    _entry_point        one source in two forms, interpreted and compiled
    _direct             rows well apart: one short pass by the Gram matrix; what it does not finish goes on to
    _projection         the thorough kernel: scales, solves, judges as the referee does, or proves infeasibility
    _scaling            rows of length ½ to 1 and numbers near 1, by powers of two: nothing is rounded
    _dual_active_set    Goldfarb & Idnani's method
    _basis              projections by an orthonormal basis of the active rows, refined where they nearly depend
    _second_thoughts    the few problems that this leaves open; the direction of least violation
"""

from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ._cache import forget_outdated_kernels

forget_outdated_kernels(Path(__file__).parent)

from ._direct import OPEN, project_directly  # noqa: E402 - after the clearing of the cache


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
    """One problem, with equalities only if tangent; see the package's head."""
    report = np.empty(3)
    project_directly.run(tangent, gradient, jacobian, bound, equality, tolerance, value_out, multipliers_out, report)
    status, changes, worst = report.tolist()
    if status == OPEN:
        alone = (array[None] for array in (gradient, jacobian, bound, equality))
        [(answer, worst)] = _thorough()(tangent, *alone, tolerance)
        status, value_out[:], multipliers_out[:], changes = answer
    return int(status), int(changes), worst


solve_cone, solve_tangent = partial(_solve_one, False), partial(_solve_one, True)


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
    report = np.empty((3, count))
    project_directly.machine_code(
        tangent,
        gradient.reshape(-1),
        jacobian.reshape(count * m, n),
        bound.reshape(-1),
        equality.reshape(-1),
        tolerance,
        _flat(value_out),
        _flat(multipliers_out),
        report.reshape(-1),
    )
    status_out[:], iterations_out[:] = report[0], report[1]
    if np.count_nonzero(status_out):  # OPTIMAL is 0
        left = np.flatnonzero(status_out)
        answers = _thorough()(tangent, gradient[left], jacobian[left], bound[left], equality[left], tolerance)
        for k, (answer, _) in zip(left, answers, strict=True):
            status_out[k], value_out[k], multipliers_out[k], iterations_out[k] = answer


def load(*, thorough: bool) -> None:
    """Machine code now, rather than when the work so far asks for it."""
    from ._projection import project_stacked

    _ = project_directly.machine_code
    if thorough:
        _ = project_stacked.machine_code


@cache
def _thorough() -> Any:
    """For what the direct pass leaves open. Imported late, for it imports the referee."""
    from ._second_thoughts import solved_thoroughly

    return solved_thoroughly


def _flat(array: Any) -> Any:
    """The same numbers in one row; raises rather than copy, which would lose what is written."""
    return array.reshape(-1, copy=False)
