"""The exact core: projections by the compiled kernels, one problem or B problems of one shape, with a proven status.

    min_d ½‖d − g‖²   s.t.   Jᵢ d ≥ bᵢ (i ∈ I),   Jᵢ d = bᵢ (i ∈ E)

The direct pass answers where rows are well apart, `thorough` the rest. M = I, no ball, C-contiguous arrays. Nothing is
checked but that NaN and overflow end as NUMERICAL_ERROR: `DirectionProblem` has validated them.
"""

from typing import Any

import numpy as np

from ..direction import Direction, DirectionBatch, KKTResiduals, Status
from ..problem import DirectionProblem, ProblemBatch
from .compiled._direct import OPEN, project_directly
from .compiled._entry_point import EntryPoint
from .compiled._projection import project_stacked
from .compiled._trust_region import climb_directly
from .thorough import solve_thoroughly

_OPTIMAL = Status.OPTIMAL


def project(problem: DirectionProblem, tolerance: float, *, tangent: bool = False) -> Direction:
    """The certified direction. tangent: UNSUPPORTED if an inequality is on (bound > −inf).

    Every microsecond here is a good part of the time of a whole solve.
    """
    g, J, b, E = problem.gradient, problem.jacobian, problem.bound, problem.equality
    value, multipliers, report = np.empty(len(g)), np.empty(len(b)), np.empty(6)
    project_directly.run(tangent, g, J, b, E, tolerance, value, multipliers, report)
    status, changes, *parts = report.tolist()
    if status == OPEN:
        return solve_thoroughly(ProblemBatch.trusted(g[None], J[None], b[None], E[None]), tolerance, tangent=tangent)[0]
    residuals = tuple.__new__(KKTResiduals, parts)  # past the named tuple's own, a function in Python
    return Direction.make(value, multipliers, _OPTIMAL, int(changes), residuals, "rows")


def project_batch(problems: ProblemBatch, tolerance: float, *, tangent: bool = False) -> DirectionBatch:
    """B problems, each exactly as `project` answers it."""
    value, multipliers, report = _run_stacked(project_directly, problems, 6, tolerance, tangent=tangent)
    status, iterations = report[:2].astype(np.int64)
    left = np.flatnonzero(status)  # OPTIMAL is 0
    answers = solve_thoroughly(problems.select(status != 0), tolerance, tangent=tangent) if left.size else []
    for k, answer in zip(left, answers, strict=True):
        status[k], value[k], multipliers[k] = answer.status, answer.value, answer.multipliers
        iterations[k], report[2:, k] = answer.iterations, answer.residuals or np.nan
    return DirectionBatch(value, multipliers, status, iterations, None, report[2:].T, np.full(len(status), "rows"))


def climb(problem: DirectionProblem, tolerance: float, *, tangent: bool = False) -> Direction | None:
    """The usual problem in a ball, M = I; None where the compiled pass has no certified answer."""
    g, J, b, E = problem.gradient, problem.jacobian, problem.bound, problem.equality
    value, multipliers, report = np.zeros(len(g)), np.zeros(len(b)), np.empty(7)
    climb_directly.run(tangent, g, J, b, E, np.array([problem.radius]), tolerance, value, multipliers, report)
    status, changes, *parts, kappa = report.tolist()
    if status == OPEN:
        return None
    return Direction(value, multipliers, _OPTIMAL, int(changes), kappa, KKTResiduals(*parts), "rows")


def climb_batch(problems: ProblemBatch, tolerance: float, *, tangent: bool = False) -> DirectionBatch:
    """B such problems: OPTIMAL with its certificate, or UNCERTIFIED, which is no answer."""
    radii = np.asarray(problems.radius)
    value, multipliers, report = _run_stacked(climb_directly, problems, 7, radii, tolerance, tangent=tangent)
    status = np.where(report[0] == OPEN, Status.UNCERTIFIED, Status.OPTIMAL)
    residuals, kappa = report[2:6].T.copy(), np.where(status, 0.0, report[6])
    residuals[status != 0] = np.nan
    rung = np.full(len(status), "rows")
    return DirectionBatch(value, multipliers, status, report[1].astype(int), kappa, residuals, rung)


def _run_stacked(kernel: EntryPoint, problems: ProblemBatch, reports: int, *settings: Any, tangent: bool) -> Any:
    """d (B, n), μ (B, m) and the reports (reports, B) of a kernel for B problems."""
    count, m, n = problems.jacobian.shape
    value, multipliers, report = np.zeros((count, n)), np.zeros((count, m)), np.empty((reports, count))
    g, b, E = problems.gradient.reshape(-1), problems.bound.reshape(-1), problems.equality.reshape(-1)
    found = value.reshape(-1), multipliers.reshape(-1), report.reshape(-1)
    kernel.run(tangent, g, problems.jacobian.reshape(-1, n), b, E, *settings, *found)
    return value, multipliers, report


def compile_kernels(*, thorough: bool = True) -> None:
    """Compiles the kernels, or loads them from the disk cache, now rather than when there is work enough for it.

    thorough: also the one for hard and infeasible problems, which takes 10 s to compile.
    """
    _ = project_directly.machine_code
    _ = climb_directly.machine_code
    if thorough:
        _ = project_stacked.machine_code
