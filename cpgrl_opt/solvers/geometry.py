"""Metric and radius around any solver: the problem where M = I, the solver or the ball's search, and the referee.

    metric    M = LLᵀ:  min ½‖x‖² − g′ᵀx  s.t.  J′x ≥ b  in x = Lᵀd, g′ = L⁻¹g, J′ = JL⁻ᵀ;  the same μ
    radius    a one-dimensional search around the core, see `trust_region`

in units where nothing over- or underflows (see `flat`). The referee judges each answer on the problem as it was given,
with M itself. Source: Golub & Van Loan, Matrix Computations, §4.2 (whitening by the Cholesky factor).
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..certify import FARKAS_TOLERANCE, certify, farkas_residual, misses_a_bound
from ..direction import Direction, DirectionBatch, Status
from ..flat import Flat, flatten
from ..problem import DirectionProblem, ProblemBatch, convert_answer, nothing
from .exact_core import climb, climb_batch
from .infeasibility import infeasible_direction
from .interface import unsupported
from .small_problem import SmallProblem, as_problem, as_small
from .span import solve_in_span
from .trust_region import climb_on_face, solve_in_ball

# A residual that a look at the rows as given would hardly mend.
_SHARP = 1e-12


Solver = Any  # of `base`, which stands on this: with its `supports`, `solve`, `solve_rows` and `solve_small`


def solve_in_geometry(solver: Solver, problem: DirectionProblem) -> Direction:
    """The answer to a problem with a metric, a radius or both; UNSUPPORTED where the solver takes no such rows."""
    if not solver.supports(problem):
        return unsupported(problem)
    if problem.metric is None and problem.is_long:
        whole = partial(_solve_whole, solver)
        return problem.vectors.attempt(solve_in_span, whole, problem, solver.tolerance)  # type: ignore[no-any-return]
    return _solve_whole(solver, problem)


def _solve_whole(solver: Solver, problem: DirectionProblem) -> Direction:
    """In all n parameters, but where the metric leaves a long problem in a ball."""
    quick, tangent = None, solver.tangent
    if problem.metric is None and tangent is not None and not problem.is_long:
        quick = climb(problem, solver.tolerance, tangent=tangent)
        if quick is not None:
            return quick
    flat = flatten(problem)
    if flat.failure is not None:
        return nothing(problem, flat.failure)
    if problem.radius is None:
        answer = (solver.solve if flat.problem.is_long else solver.solve_rows)(flat.problem)
        return _bring_back(problem, flat, answer, solver.tolerance)
    if problem.metric is not None and flat.problem.is_long:
        quick = solve_in_geometry(solver, flat.problem)
    elif problem.metric is not None and tangent is not None:
        quick = climb(flat.problem, solver.tolerance, tangent=tangent)
    # What the compiled pass leaves open may be hard because a metric hides that J and b are infeasible: the search
    # would go all its way, ten times as long, and see nothing. A pass of one's own has left nothing open yet.
    is_hard = problem.metric is not None and tangent is not None and quick is None
    empty = infeasible_direction(problem) if is_hard else None
    found = _try(solver, problem, flat, quick or solve_in_ball(solver.solve_small, flat, empty))
    if found.status not in (Status.UNCERTIFIED, Status.NUMERICAL_ERROR) or tangent is not None:
        return found
    # What a core says of hard problems is no more than a guess: once more with what stands around it.
    empty = None if problem.metric is None else infeasible_direction(problem)
    again = solve_in_ball(lambda small: as_small(solver.solve_rows(as_problem(small))), flat, empty)
    return _try(solver, problem, flat, again)


def _try(solver: Solver, problem: DirectionProblem, flat: Flat, answer: Direction) -> Direction:
    """What is found in the ball, and, where that is not sharp, what its face says by the rows as given."""
    found = _bring_back(problem, flat, answer, solver.tolerance)
    is_sharp = found.residuals is not None and max(found.residuals) <= _SHARP
    if is_sharp or callable(problem.metric) or found.status not in (Status.OPTIMAL, Status.UNCERTIFIED):
        return found
    held, rows = problem.equality | (answer.multipliers != 0.0), flat.problem
    small = SmallProblem(rows.gradient, rows.jacobian, rows.bound, rows.equality)
    is_face = (rows.bound[held] > -np.inf).all()
    for value, mu, kappa in climb_on_face(small, float(rows.radius or 0.0), held) if is_face else ():
        sharper = Direction(value, mu, Status.OPTIMAL, answer.iterations, kappa, rung="rows")
        again = _bring_back(problem, flat, sharper, solver.tolerance)
        if again.residuals is not None and (found.residuals is None or again.residuals.worst < found.residuals.worst):
            found = again
    return found


def solve_batch_in_geometry(solver: Solver, problems: ProblemBatch) -> DirectionBatch:
    """B problems, each as alone; what a compiled pass does is done together."""
    if callable(problems.metric):  # each in coordinates of its own
        return DirectionBatch.stack([solver.solve(problem) for problem in problems])
    flats = [] if problems.metric is None else list(map(flatten, problems))
    flat_batch = _stack([each.problem for each in flats]) if flats else problems
    if any(each.failure is not None for each in flats) or (problems.radius is not None and solver.tangent is None):
        return DirectionBatch.stack([solver.solve(problem) for problem in problems])
    answers: DirectionBatch
    if problems.radius is None:
        answers = solver.solve_rows_batch(flat_batch)
    else:
        answers = climb_batch(flat_batch, solver.tolerance, tangent=bool(solver.tangent))
    left = answers.status != Status.OPTIMAL
    if not flats:
        again = [solver.solve(problem) for problem in problems.select(left)]
        return answers.replace_where(left, DirectionBatch.stack(again)) if again else answers
    found = []
    for problem, flat, answer, is_open in zip(problems, flats, answers, left.tolist(), strict=True):
        is_open = is_open and problems.radius is not None
        found.append(solver.solve(problem) if is_open else _bring_back(problem, flat, answer, solver.tolerance))
    return DirectionBatch.stack(found)


def _stack(flats: list[DirectionProblem]) -> ProblemBatch:
    """As they are, without checks."""
    g, J, b, E = map(np.stack, zip(*(each.arrays() for each in flats), strict=True))
    return ProblemBatch.trusted(g, J, b, E, None if flats[0].radius is None else np.array([p.radius for p in flats]))


def _bring_back(problem: DirectionProblem, flat: Flat, answer: Direction, tolerance: float) -> Direction:
    """What is claimed of the flat problem, as an answer to the problem itself; the referee's word stands."""
    if answer.status == Status.UNSUPPORTED:
        return unsupported(problem)
    value, multipliers, kappa = flat.outside(answer.value, answer.multipliers, answer.radius_multiplier)
    if not (np.isfinite(value).all() and np.isfinite(multipliers).all() and np.isfinite(kappa)):
        return nothing(problem, Status.NUMERICAL_ERROR, answer.iterations)
    found = Direction(value, multipliers, Status(answer.status), answer.iterations, kappa, rung=answer.rung)
    is_exact = problem.metric is None or (  # units round nothing, or next to nothing
        getattr(problem.metric, "ndim", 2) == 1 and not misses_a_bound(problem, value)
    )
    if answer.residuals is not None and is_exact:
        found = replace(found, residuals=answer.residuals)
    else:
        found = certify(problem, found, tolerance, infeasible_direction)
    # And no claim of somebody else's; the ball's search is ours, whatever core it asks.
    is_ours = answer.residuals is not None or answer.status == Status.INFEASIBLE or problem.radius is not None
    if found.status == Status.UNCERTIFIED and is_ours and misses_a_bound(problem, value):
        found = _contradict(problem, found, tolerance)
    if found.status == Status.INFEASIBLE and callable(problem.metric) and not _is_beyond_doubt(problem, found):
        found = replace(found, status=Status.UNCERTIFIED)
    return convert_answer(problem, found) if problem.is_tree else found


def _is_beyond_doubt(problem: DirectionProblem, found: Direction) -> bool:
    """Whether J and b are infeasible as they are, or bᵀy > radius ‖Jᵀy‖_M⁻¹ by M⁻¹ itself.

    Rows that depend to the tolerance of M⁻¹ by products seem to contradict each other in its coordinates.
    """
    if infeasible_direction(problem) is not None:
        return True
    return problem.radius is not None and farkas_residual(problem, found.multipliers) <= FARKAS_TOLERANCE


def _contradict(problem: DirectionProblem, found: Direction, tolerance: float) -> Direction:
    """INFEASIBLE where J and b are so by themselves, in units that metric and ball have no say in.

    Of least violation where it is in the ball, else the direction that was found, which violates as little in M.
    """
    proof = infeasible_direction(problem, found.iterations)
    if proof is None:
        return found
    for value in proof.value, found.value:
        answer = certify(problem, replace(proof, value=value), tolerance, infeasible_direction)
        if answer.status == Status.INFEASIBLE:
            return answer
    return found
