"""What the direct pass leaves open: one pass of the thorough kernel, or several; and least violations.

Rare, so in plain Python around the kernel; the referee itself judges each attempt.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import frexp, inf
from typing import Any

import numpy as np

from ..certify import is_proven, kkt_residuals, misses_a_bound
from ..direction import Direction, KKTResiduals, Status
from ..problem import DirectionProblem, ProblemBatch
from ..scaling import demand, lengths, unit_rows
from .compiled._dual_active_set import LAST, LENIENT, LOOSE, PLAIN, POLISHING, REFINED
from .compiled._projection import project_stacked
from .compiled._workspace import Booleans, Floats

EXACT = 1e-12  # worst residual that ends the attempts
_SETTLED = (Status.OPTIMAL, Status.NUMERICAL_ERROR, Status.UNSUPPORTED)
_CLAIMING_A_POINT = (Status.OPTIMAL, Status.UNCERTIFIED, Status.ITERATION_LIMIT)
_FAR = -1e3  # rows with bounds below this stay out of the least violation, which they would swamp, until violated
_SIZE = 1e6  # bounds up to this many times as large are solved for together: ten digits are left of the smallest
_LEAST = 1e-13  # violations below this are rounding
_RANK = 3e-13  # columns of unit rows below this: with a tenth, rows 1e-13 rad from opposing would be left UNCERTIFIED


def solve_thoroughly(problems: ProblemBatch, tolerance: float, *, tangent: bool = False) -> list[Direction]:
    """Answers to B problems that the direct pass leaves open; tangent: takes no inequality."""
    arrays = problems.gradient, problems.jacobian, problems.bound, problems.equality
    answers = _solve_all(*arrays, PLAIN, min(tolerance, EXACT), tangent=tangent)
    return [_look_again(*pair, tolerance) for pair in zip(problems, answers, strict=True)]


def _look_again(problem: DirectionProblem, answer: Direction, tolerance: float) -> Direction:
    if answer.status not in _SETTLED:
        answer = reconsider(problem, answer, tolerance)
    if answer.status in _CLAIMING_A_POINT and (conflict := find_contradiction(problem, answer.value)) is not None:
        answer = _prove(problem, conflict)
    return answer


def find_contradiction(problem: DirectionProblem, value: Floats) -> Direction | None:
    """The proof that rows contradict each other, however little it is that d misses beside g or another bound.

    Where a row is missed by more than 1e-9 of the least that any asks for, rows are looked at with g = 0, first those
    with bounds of that size or less, then with larger and larger ones.
    """
    if not misses_a_bound(problem, value):
        return None
    rows = unit_rows(problem.jacobian)
    on = (rows.largest > 0.0) & (problem.bound > -inf)
    bound = np.where(on, rows.per_length(problem.bound), 0.0)
    asked = np.unique(demand(bound, problem.equality))
    for size in _apart(asked[asked > 0.0]):
        near = on & (np.abs(bound) <= _SIZE * size)
        found = _solve(np.zeros_like(value), rows.jacobian[near], bound[near] / size, problem.equality[near], PLAIN)
        if found.status == Status.INFEASIBLE:
            proof = np.zeros(len(bound))
            proof[near] = found.multipliers
            return replace(found, value=value, multipliers=rows.per_length(proof))
    return None


def _apart(sizes: Floats) -> Iterator[float]:
    """Some of the ascending sizes, each a thousand times the one before or more."""
    last = 0.0
    for size in sizes.tolist():
        if size > 1e3 * last:
            last = size
            yield size


def reconsider(problem: DirectionProblem, first: Direction, tolerance: float) -> Direction:
    """The best answer of all attempts; starts from `first`."""
    best, least, changes = first, inf, 0
    for answer in _attempts(problem, first):
        changes += answer.iterations
        if answer.status == Status.INFEASIBLE:
            return _prove(problem, answer)
        if answer.status == Status.NUMERICAL_ERROR:
            continue
        residuals = kkt_residuals(problem, answer)
        worst = residuals.worst
        if worst < least:
            best, least = replace(answer, residuals=residuals), worst
        if worst <= min(EXACT, tolerance):
            break
    if least <= tolerance:
        return replace(best, status=Status.OPTIMAL, iterations=changes)
    return replace(best, status=max(best.status, Status.UNCERTIFIED), iterations=changes, residuals=None)


def _attempts(problem: DirectionProblem, first: Direction) -> Iterator[Direction]:
    """First; then refined, lenient, and with a looser idea of rounding, each polished twice."""
    yield first
    arrays = problem.gradient, problem.jacobian, problem.bound, problem.equality
    for attempt in (REFINED, LENIENT, LAST):
        answer = _solve(*arrays, attempt)
        yield answer
        if answer.status in (Status.INFEASIBLE, Status.NUMERICAL_ERROR):
            continue
        for grade in (POLISHING, POLISHING + 1):
            answer = replace(answer, value=_polish(problem, answer, grade), iterations=0)
            yield answer


def _polish(problem: DirectionProblem, answer: Direction, grade: int) -> Floats:
    """The point nearest to d that keeps the rows with multipliers, as far as they are well apart.

    Where rows at an angle θ from opposing are active, another row can be violated by eps/θ though moving d by as much
    changes theirs by eps only, and μ ~ 1/θ allows for the move.
    """
    held = problem.equality | (answer.multipliers != 0.0)
    value: Floats = _solve(answer.value, problem.jacobian, problem.bound, held, grade).value
    return value


def _prove(problem: DirectionProblem, conflict: Direction) -> Direction:
    """INFEASIBLE with the direction of least violation, or UNCERTIFIED if the referee doubts either."""
    answer = _violate_least(problem, conflict)
    if answer.status == Status.INFEASIBLE and not is_proven(problem, answer):
        return replace(answer, status=Status.UNCERTIFIED)
    return answer


def _violate_least(problem: DirectionProblem, proven: Direction) -> Direction:
    """The same proof with the d that minimises ‖(b̂ − Ĵd)₊‖₂ on unit rows, the nearest to g of them.

        y = argmin ½‖y − b̂‖²   s.t.  Ĵᵀy = 0,  y ≥ 0 on I                = (b̂ − Ĵd)₊ for every such d
        d = argmin ½‖d − g‖²   s.t.  Ĵd ≥ b̂ − y,  with equality on E and where y > 0

    Source: the KKT conditions of min ½‖(b̂ − Ĵd)₊‖².
    """
    rows = unit_rows(problem.jacobian)
    on = (rows.largest > 0.0) & (problem.bound > -inf)
    unit, bound, exact = rows.jacobian[on], rows.per_length(problem.bound)[on], problem.equality[on]
    required = demand(bound, exact).max(initial=0.0)
    if required == 0.0 and not problem.gradient.any():  # d = 0, and no number to measure rounding by
        return replace(proven, value=np.zeros_like(problem.gradient))
    exponent = frexp(max(float(lengths(problem.gradient)), float(required)))[1]
    gradient, bound = np.ldexp(problem.gradient, -exponent), np.ldexp(bound, -exponent)
    named = float(np.abs(bound[proven.multipliers[on] != 0.0]).max(initial=0.0)) or inf
    included = (exact | (bound > _FAR)) & (np.abs(bound) <= _SIZE * named)  # beside larger ones y would be rounding
    while True:
        y = np.zeros(len(bound))
        y[included] = _residual(unit[included], bound[included], exact[included])
        d = _solve(gradient, unit, bound - y, exact | (y > 0.0), LOOSE).value
        new = ~included & (bound - unit @ d > _LEAST * (1.0 + float(lengths(d))))
        if not new.any():
            break
        included |= new
    value = np.ldexp(d, exponent)
    if not (np.isfinite(value).all() and np.isfinite(proven.multipliers).all()):
        return Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR, proven.iterations)
    return replace(proven, value=value)


def _residual(unit: Floats, bound: Floats, exact: Booleans) -> Floats:
    """y of _violate_least; exactly 0 where y ≥ 0 is active or y is rounding."""
    count = len(unit)
    if count == 0:
        return np.zeros(0)
    largest = float(np.abs(bound).max(initial=0.0)) or 1.0
    # As a row of its own, what rounding leaves of a column would ask as much as any other.
    columns = unit.T[lengths(unit.T) > _RANK]
    n = len(columns)
    constraints = np.vstack([columns, np.eye(count)])
    limits = np.append(np.zeros(n), np.where(exact, -inf, 0.0))
    answer = _solve(bound / largest, constraints, limits, np.append(np.ones(n, bool), np.zeros(count, bool)), LOOSE)
    y: Floats = answer.value * largest
    return np.where(exact | ((answer.multipliers[n:] == 0.0) & (y > _LEAST * min(largest, 1.0))), y, 0.0)


def _solve(gradient: Floats, jacobian: Floats, bound: Floats, equality: Booleans, attempt: int) -> Direction:
    """One pass of the kernel over one problem."""
    arrays: list[Any] = [np.ascontiguousarray(array)[None] for array in (gradient, jacobian, bound, equality)]
    g, J, b, E = arrays
    return _solve_all(g, J, b, E, attempt)[0]


def _solve_all(
    gradient: Floats, jacobian: Floats, bound: Floats, equality: Booleans, attempt: int, exact: float = EXACT,
    *, tangent: bool = False,
) -> list[Direction]:  # fmt: skip
    """One pass of the kernel over B problems, as it reports them."""
    count, m, n = jacobian.shape
    value, multipliers, reports = np.zeros((count, n)), np.zeros((count, m)), np.full((6, count), inf)
    reports[:2] = [[Status.NUMERICAL_ERROR], [0.0]]  # stand where there is no coordinate
    given = gradient.ravel(), jacobian.reshape(count * m, n), bound.ravel(), equality.ravel()
    project_stacked(tangent, int(attempt), *given, exact, value.ravel(), multipliers.ravel(), reports.ravel())
    answers = []
    for k, (status, changes, *residuals) in enumerate(reports.T.tolist()):
        known = KKTResiduals(*residuals) if status == Status.OPTIMAL else None
        answers.append(Direction.make(value[k], multipliers[k], Status(int(status)), int(changes), known, "rows"))
    return answers
