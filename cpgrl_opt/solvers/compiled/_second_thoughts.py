"""What the direct pass leaves open: one pass of the thorough kernel, or several; and least violations.

Rare, so in plain Python around the kernel; the referee itself judges each attempt.
"""

from collections.abc import Iterator
from math import frexp, inf
from typing import NamedTuple

import numpy as np

from ...certify import kkt_residuals
from ...direction import Direction, Status
from ...problem import DirectionProblem, lengths, unit_rows
from ..infeasibility import is_proven
from ._direct import MISSED
from ._dual_active_set import LAST, LENIENT, LOOSE, PLAIN, POLISHING, REFINED
from ._projection import project_stacked
from ._workspace import Booleans, Floats

EXACT = 1e-12  # worst residual that ends the attempts
_SETTLED = (Status.OPTIMAL, Status.NUMERICAL_ERROR, Status.UNSUPPORTED)
_CLAIMING_A_POINT = (Status.OPTIMAL, Status.UNCERTIFIED, Status.ITERATION_LIMIT)
_FAR = -1e3  # rows with bounds below this stay out of the least violation, which they would swamp, until violated
_SIZE = 1e6  # bounds up to this many times as large are solved for together: ten digits are left of the smallest
_LEAST = 1e-13  # violations below this are rounding


class Problem(NamedTuple):
    """g (n,), J (m, n), b (m,), E (m,)."""

    gradient: Floats
    jacobian: Floats
    bound: Floats
    equality: Booleans


class Answer(NamedTuple):
    """What the kernel returns."""

    status: int
    value: Floats
    multipliers: Floats
    changes: int


def solved_thoroughly(
    tangent: bool, gradient: Floats, jacobian: Floats, bound: Floats, equality: Booleans, tolerance: float
) -> list[tuple[Answer, float]]:
    """Answers to B problems (B, n), (B, m, n), (B, m), (B, m), each with its worst residual."""
    count, m, n = jacobian.shape
    values, multipliers, reports = np.empty((count, n)), np.empty((count, m)), np.empty((3, count))
    project_stacked(
        tangent,
        int(PLAIN),
        gradient.ravel(),
        jacobian.reshape(-1, n),
        bound.ravel(),
        equality.ravel(),
        min(tolerance, EXACT),
        values.ravel(),
        multipliers.ravel(),
        reports.ravel(),
    )
    answers = []
    for k, (status, changes, worst) in enumerate(reports.T.tolist()):
        answer = Answer(int(status), values[k], multipliers[k], int(changes))
        problem = Problem(gradient[k], jacobian[k], bound[k], equality[k])
        if status not in _SETTLED:
            answer, worst = reconsidered(problem, answer, tolerance)
        if answer.status in _CLAIMING_A_POINT and (conflict := contradiction(problem, answer.value)) is not None:
            answer, worst = _proven(problem, DirectionProblem(*problem), conflict), inf
        answers.append((answer, worst))
    return answers


def contradiction(problem: Problem, value: Floats) -> Answer | None:
    """The proof that rows which d misses contradict each other, however short that is beside g or another bound.

    Each row missed by more than 1e-9 of its own bound is looked at with g = 0 among those with bounds of its size.
    """
    rows = unit_rows(problem.jacobian)
    on = (rows.largest > 0.0) & (problem.bound > -inf)
    bound = np.where(on, rows.per_length(problem.bound), 0.0)
    if not bound.any():
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        lack = bound - rows.jacobian @ value
    missed = np.where(problem.equality, np.abs(lack), lack) > MISSED * np.abs(bound)
    for size in np.unique(np.abs(bound[on & missed & (bound != 0.0)])):
        near = on & (np.abs(bound) <= _SIZE * size)
        part = Problem(np.zeros_like(value), rows.jacobian[near], bound[near] / size, problem.equality[near])
        found = solved(part, PLAIN)
        if found.status == Status.INFEASIBLE:
            proof = np.zeros(len(bound))
            proof[near] = found.multipliers
            return Answer(int(Status.INFEASIBLE), value, rows.per_length(proof), found.changes)
    return None


def solved(problem: Problem, attempt: int) -> Answer:
    """One pass of the kernel."""
    m, n = problem.jacobian.shape
    value, multipliers = np.zeros(n), np.zeros(m)
    report = np.array([Status.NUMERICAL_ERROR, 0.0, inf])  # what stands where there is no coordinate to solve for
    arrays = tuple(np.ascontiguousarray(array) for array in problem)
    project_stacked(False, int(attempt), *arrays, EXACT, value, multipliers, report)
    return Answer(int(report[0]), value, multipliers, int(report[1]))


def reconsidered(problem: Problem, first: Answer, tolerance: float) -> tuple[Answer, float]:
    """The best answer of all attempts and its worst residual (inf where there is none); starts from `first`."""
    validated = DirectionProblem(*problem)
    if first.status == Status.INFEASIBLE:
        return _proven(problem, validated, first), inf
    best, least, changes = first, inf, 0
    for answer in _attempts(problem, first):
        changes += answer.changes
        if answer.status == Status.INFEASIBLE:
            return _proven(problem, validated, answer), inf
        if answer.status == Status.NUMERICAL_ERROR:
            continue
        direction = Direction(answer.value, answer.multipliers, Status(answer.status))
        worst = kkt_residuals(validated, direction).worst
        if worst < least:
            best, least = answer, worst
        if worst <= min(EXACT, tolerance):
            break
    status = Status.OPTIMAL if least <= tolerance else max(best.status, Status.UNCERTIFIED)
    return best._replace(status=int(status), changes=changes), least


def _attempts(problem: Problem, first: Answer) -> Iterator[Answer]:
    """First; then refined, lenient, and with a looser idea of rounding, each polished twice."""
    yield first
    for attempt in (REFINED, LENIENT, LAST):
        answer = solved(problem, attempt)
        yield answer
        if answer.status in (Status.INFEASIBLE, Status.NUMERICAL_ERROR):
            continue
        for grade in (POLISHING, POLISHING + 1):
            answer = answer._replace(value=_polished(problem, answer, grade), changes=0)
            yield answer


def _polished(problem: Problem, answer: Answer, grade: int) -> Floats:
    """The point nearest to d that keeps the rows with multipliers, as far as they are well apart.

    Where rows at an angle θ from opposing are active, another row can be violated by eps/θ though moving d by as much
    changes theirs by eps only, and μ ~ 1/θ allows for the move.
    """
    held = problem.equality | (answer.multipliers != 0.0)
    return solved(problem._replace(gradient=answer.value, equality=held), grade).value


def _proven(problem: Problem, validated: DirectionProblem, conflict: Answer) -> Answer:
    """INFEASIBLE with the direction of least violation, or UNCERTIFIED if the referee doubts either."""
    answer = least_violating(problem, conflict)
    direction = Direction(answer.value, answer.multipliers, Status(answer.status))
    if answer.status == Status.INFEASIBLE and not is_proven(validated, direction):
        return answer._replace(status=int(Status.UNCERTIFIED))
    return answer


def least_violating(problem: Problem, proven: Answer) -> Answer:
    """The same proof with the d that minimises ‖(b̂ − Ĵd)₊‖₂ on unit rows, the nearest to g of them.

        y = argmin ½‖y − b̂‖²   s.t.  Ĵᵀy = 0,  y ≥ 0 on I                = (b̂ − Ĵd)₊ for every such d
        d = argmin ½‖d − g‖²   s.t.  Ĵd ≥ b̂ − y,  with equality on E and where y > 0

    Source: the KKT conditions of min ½‖(b̂ − Ĵd)₊‖².
    """
    rows = unit_rows(problem.jacobian)
    on = (rows.largest > 0.0) & (problem.bound > -inf)
    unit, bound, exact = rows.jacobian[on], rows.per_length(problem.bound)[on], problem.equality[on]
    required = np.where(exact, np.abs(bound), np.maximum(bound, 0.0)).max(initial=0.0)
    if required == 0.0 and not problem.gradient.any():  # d = 0, and no number to measure rounding by
        return proven._replace(value=np.zeros_like(problem.gradient))
    exponent = frexp(max(float(lengths(problem.gradient)), float(required)))[1]
    gradient, bound = np.ldexp(problem.gradient, -exponent), np.ldexp(bound, -exponent)
    included = exact | (bound > _FAR)
    while True:
        y = np.zeros(len(bound))
        y[included] = _residual(unit[included], bound[included], exact[included])
        d = solved(Problem(gradient, unit, bound - y, exact | (y > 0.0)), LOOSE).value
        new = ~included & (bound - unit @ d > _LEAST * (1.0 + float(lengths(d))))
        if not new.any():
            break
        included |= new
    value = np.ldexp(d, exponent)
    if not (np.isfinite(value).all() and np.isfinite(proven.multipliers).all()):
        return Answer(int(Status.NUMERICAL_ERROR), 0.0 * gradient, np.zeros(len(on)), proven.changes)
    return proven._replace(value=value)


def _residual(unit: Floats, bound: Floats, exact: Booleans) -> Floats:
    """y of least_violating; exactly 0 where y ≥ 0 is active or y is rounding."""
    count, n = unit.shape
    if count == 0:
        return np.zeros(0)
    largest = float(np.abs(bound).max(initial=0.0)) or 1.0
    constraints = np.vstack([unit.T, np.eye(count)])
    limits = np.append(np.zeros(n), np.where(exact, -inf, 0.0))
    answer = solved(
        Problem(bound / largest, constraints, limits, np.append(np.ones(n, bool), np.zeros(count, bool))), LOOSE
    )
    y: Floats = answer.value * largest
    return np.where(exact | ((answer.multipliers[n:] == 0.0) & (y > _LEAST * min(largest, 1.0))), y, 0.0)
