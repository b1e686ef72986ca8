"""Metric and radius around any solver: the problem where M = I, the solver or the ball's search, and the referee.

    metric    M = LLᵀ:  min ½‖x‖² − g′ᵀx  s.t.  J′x ≥ b  in x = Lᵀd, g′ = L⁻¹g, J′ = JL⁻ᵀ;  the same μ
    radius    a one-dimensional search around the core, see `trust_region`

in units where nothing over- or underflows (see `flat`). The referee judges each answer on the problem as it was given,
with M itself. Source: Golub & Van Loan, Matrix Computations, §4.2 (whitening by the Cholesky factor).
"""

from collections.abc import Callable

import numpy as np

from ..certify import certify
from ..direction import Direction, DirectionBatch, Status
from ..flat import Flat, flatten
from ..problem import DirectionProblem, ProblemBatch
from .infeasibility import infeasible_direction
from .interface import unsupported
from .small_problem import Core
from .trust_region import as_problem, as_small, solve_in_ball

Solve = Callable[[DirectionProblem], Direction]


def solve_in_geometry(problem: DirectionProblem, solve: Solve, core: Core, tolerance: float) -> Direction:
    """The answer to a problem with a metric, a radius or both; solve: of Euclidean problems without a ball."""
    flat = flatten(problem)
    if not flat.is_finite:
        return Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR)
    if problem.radius is None:
        return _bring_back(problem, flat, solve(flat.problem), tolerance)
    found = _bring_back(problem, flat, solve_in_ball(core, flat.problem), tolerance)
    if found.status not in (Status.UNCERTIFIED, Status.NUMERICAL_ERROR):
        return found
    # What a core says of hard problems is no more than a guess: once more with what stands around it.
    again = solve_in_ball(lambda small: as_small(solve(as_problem(small))), flat.problem)
    return _bring_back(problem, flat, again, tolerance)


def solve_batch_in_geometry(
    problems: ProblemBatch, solve: Solve, batch: Callable[[ProblemBatch], DirectionBatch], tolerance: float
) -> DirectionBatch:
    """Problems in metrics, without balls, as one by one; solved together."""
    flats = list(map(flatten, problems))
    if not all(each.is_finite for each in flats):
        return DirectionBatch.stack([solve(problem) for problem in problems])
    stacked = (np.stack([getattr(each.problem, name) for each in flats]) for name in ("gradient", "jacobian", "bound"))
    answers = batch(ProblemBatch.trusted(*stacked, problems.equality))
    triples = zip(problems, flats, answers, strict=True)
    return DirectionBatch.stack([_bring_back(*triple, tolerance) for triple in triples])


def _bring_back(problem: DirectionProblem, flat: Flat, answer: Direction, tolerance: float) -> Direction:
    """What is claimed of the flat problem, as an answer to the problem itself; the referee's word stands."""
    kappa = float(getattr(answer, "radius_multiplier", 0.0))
    value, multipliers = (np.asarray(each, dtype=np.float64) for each in (answer.value, answer.multipliers))
    value, multipliers, kappa = flat.outside(value, multipliers, kappa)
    status, iterations = Status(answer.status), getattr(answer, "iterations", 0)
    if status == Status.UNSUPPORTED:
        return unsupported(problem)
    if not (np.isfinite(value).all() and np.isfinite(multipliers).all() and np.isfinite(kappa)):
        return Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR, iterations)
    found = Direction(value, multipliers, status, iterations, kappa, rung=getattr(answer, "rung", ""))
    return certify(problem, found, tolerance, infeasible_direction)
