"""Metric and radius around any solver: the problem where M = I, the solver or the ball's search, and the referee.

    metric    M = LLᵀ:  min ½‖x‖² − g′ᵀx  s.t.  J′x ≥ b  in x = Lᵀd, g′ = L⁻¹g, J′ = JL⁻ᵀ;  the same μ
    radius    a one-dimensional search around the core, see `trust_region`

in units where nothing over- or underflows (see `flat`). The referee judges each answer on the problem as it was given,
with M itself. Source: Golub & Van Loan, Matrix Computations, §4.2 (whitening by the Cholesky factor).
"""

from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from ..certify import certify
from ..direction import Direction, DirectionBatch, Status
from ..flat import Flat, flatten
from ..flat_span import SpanFlat
from ..problem import DirectionProblem, ProblemBatch, in_form, needs_the_metric_itself, nothing
from .infeasibility import infeasible_direction
from .interface import unsupported
from .small_problem import SmallAnswer, SmallProblem, as_problem, as_small
from .span import solve_in_span
from .trust_region import sharpen, solve_in_ball

# A residual that a look at the rows as given would hardly mend.
_SHARP = 1e-12
_ARRAYS = ("gradient", "jacobian", "bound", "equality")


class Around(Protocol):
    """What a metric and a ball are put around."""

    @property
    def tolerance(self) -> float:
        """The worst residual of an OPTIMAL answer."""
        ...

    def supports(self, problem: DirectionProblem) -> bool:
        """Whether it takes the problem."""
        ...

    def solve(self, problem: DirectionProblem) -> Direction:
        """Any problem."""
        ...

    def solve_rows(self, problem: DirectionProblem) -> Direction:
        """With M = I, no ball, short vectors."""
        ...

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """The core alone."""
        ...

    def solve_rows_batch(self, problems: ProblemBatch) -> DirectionBatch:
        """B such problems."""
        ...

    def climb(self, problems: ProblemBatch) -> DirectionBatch | None:
        """Problems in balls, M = I, as far as a compiled pass gets; None where there is none."""
        ...


def solve_in_geometry(solver: Around, problem: DirectionProblem) -> Direction:
    """The answer to a problem with a metric, a radius or both; UNSUPPORTED where the solver takes no such rows."""
    if not solver.supports(problem):
        return unsupported(problem)
    if problem.metric is None and problem.is_long:
        return solve_in_span(partial(_solve_whole, solver), problem, solver.tolerance, is_exact=False)
    return _solve_whole(solver, problem)


def _solve_whole(solver: Around, problem: DirectionProblem) -> Direction:
    """In all n parameters, but where the metric leaves a long problem in a ball."""
    if problem.metric is None and (quick := _climb(solver, problem)) is not None:
        return quick
    flat = flatten(problem)
    if flat.failure is not None:
        return nothing(problem, flat.failure)
    if problem.radius is None:
        answer = (solver.solve if flat.problem.is_long else solver.solve_rows)(flat.problem)
        return _bring_back(problem, flat, answer, solver.tolerance)
    quick = None
    if problem.metric is not None:
        quick = solve_in_geometry(solver, flat.problem) if flat.problem.is_long else _climb(solver, flat.problem)
    found = _try(solver, problem, flat, quick or solve_in_ball(solver.solve_small, flat.problem))
    if found.status not in (Status.UNCERTIFIED, Status.NUMERICAL_ERROR):
        return found
    # What a core says of hard problems is no more than a guess: once more with what stands around it.
    again = solve_in_ball(lambda small: as_small(solver.solve_rows(as_problem(small))), flat.problem)
    return _try(solver, problem, flat, again)


def _try(solver: Around, problem: DirectionProblem, flat: Flat | SpanFlat, answer: Direction) -> Direction:
    """What is found in the ball, and, where that is not sharp, what its face says by the rows as given."""
    found = _bring_back(problem, flat, answer, solver.tolerance)
    is_sharp = found.residuals is not None and found.residuals.worst <= _SHARP
    if is_sharp or isinstance(flat, SpanFlat) or found.status not in (Status.OPTIMAL, Status.UNCERTIFIED):
        return found
    sharper = sharpen(flat.problem, answer)
    if sharper is None:
        return found
    again = _bring_back(problem, flat, replace(sharper, status=Status.OPTIMAL), solver.tolerance)
    if again.residuals is None or (found.residuals is not None and found.residuals.worst <= again.residuals.worst):
        return found
    return again


def solve_batch_in_geometry(solver: Around, problems: ProblemBatch) -> DirectionBatch:
    """B problems, each as alone; what a compiled pass does is done together."""
    if callable(problems.metric):  # each in coordinates of its own
        return DirectionBatch.stack([solver.solve(problem) for problem in problems])
    flats = [] if problems.metric is None else list(map(flatten, problems))
    flat_batch = _stack([each.problem for each in flats]) if flats else problems
    answers = solver.solve_rows_batch(flat_batch) if problems.radius is None else solver.climb(flat_batch)
    if answers is None or any(each.failure is not None for each in flats):
        return DirectionBatch.stack([solver.solve(problem) for problem in problems])
    left = answers.status != Status.OPTIMAL
    if not flats:
        again = [solver.solve(problem) for problem in problems.chosen(left)]
        return answers.replaced(left, DirectionBatch.stack(again)) if again else answers
    found = []
    for problem, flat, answer, is_open in zip(problems, flats, answers, left.tolist(), strict=True):
        is_open = is_open and problems.radius is not None
        found.append(solver.solve(problem) if is_open else _bring_back(problem, flat, answer, solver.tolerance))
    return DirectionBatch.stack(found)


def _climb(solver: Around, flat: DirectionProblem) -> Direction | None:
    """The answer of the compiled pass, where it has one."""
    if flat.is_long:
        return None
    alone = flat.gradient[None], flat.jacobian[None], flat.bound[None], flat.equality[None], np.array([flat.radius])
    answers = solver.climb(ProblemBatch.trusted(*alone))
    return answers[0] if answers is not None and answers.status[0] == Status.OPTIMAL else None


def _stack(flats: list[DirectionProblem]) -> ProblemBatch:
    """As they are, without checks."""
    g, J, b, E = (np.stack([getattr(each, name) for each in flats]) for name in _ARRAYS)
    return ProblemBatch.trusted(g, J, b, E, None if flats[0].radius is None else np.array([p.radius for p in flats]))


def _bring_back(problem: DirectionProblem, flat: Flat | SpanFlat, answer: Direction, tolerance: float) -> Direction:
    """What is claimed of the flat problem, as an answer to the problem itself; the referee's word stands."""
    kappa = float(getattr(answer, "radius_multiplier", 0.0))
    value, multipliers = np.asarray(answer.value, np.float64), np.asarray(answer.multipliers, np.float64)
    value, multipliers, kappa = flat.outside(value, multipliers, kappa)
    status, iterations = Status(answer.status), getattr(answer, "iterations", 0)
    if status == Status.UNSUPPORTED:
        return unsupported(problem)
    if not (np.isfinite(value).all() and np.isfinite(multipliers).all() and np.isfinite(kappa)):
        return nothing(problem, Status.NUMERICAL_ERROR, iterations)
    found = Direction(value, multipliers, status, iterations, kappa, rung=getattr(answer, "rung", ""))
    if answer.residuals is not None and not needs_the_metric_itself(problem):
        found = replace(found, residuals=answer.residuals)  # of units that round nothing, or next to nothing
    else:
        found = certify(problem, found, tolerance, infeasible_direction)
    return in_form(problem, found) if problem.is_tree else found
