"""Long vectors: a problem of many parameters solved in the 1 + m coordinates of its own gradients, by any solver.

Each rung of `reduction` is tried in turn, and what it gives is judged on the vectors themselves. What no rung answers
is solved on the rows as they are.
"""

from collections.abc import Callable
from dataclasses import replace
from math import inf

import numpy as np

from ..direction import Direction, Status
from ..kkt import certified_residuals, kkt_residuals
from ..problem import DirectionProblem, lengths
from ..reduction import EXACT, RUNGS, coordinates

_SETTLED = (Status.INFEASIBLE, Status.UNSUPPORTED)  # no better rung says otherwise


def solve_in_span(
    solve: Callable[[DirectionProblem], Direction], problem: DirectionProblem, tolerance: float
) -> Direction:
    """The problem in coordinates, by `solve`; mapped back, and certified at the tolerance. M = I, no radius."""
    vectors, on = problem.vectors, problem.bound > -inf
    for rung in RUNGS:
        small = coordinates(vectors, on, rung)
        if small is None:
            continue
        reduced = DirectionProblem.trusted(small.gradient, small.jacobian, problem.bound, problem.equality)
        found = solve(reduced)
        value, certificate = vectors.combine(small.weights(found.value), found.multipliers)
        answer = replace(found, value=value, rung=rung)
        if found.status == Status.OPTIMAL:
            residuals = certified_residuals(certificate, problem, found.multipliers, small.lengths)
            excess = residuals.worst - EXACT if rung == RUNGS[0] else 0.0
            if residuals.worst <= tolerance and (excess <= 0.0 or excess <= kkt_residuals(reduced, found).worst):
                return replace(answer, residuals=residuals)
        elif rung == RUNGS[-1] or found.status in _SETTLED:
            unit = max(float(lengths(found.value)), float(small.lengths[0])) or 1.0
            if small.holds(found.value, certificate, unit):
                return answer
    g, J = np.ascontiguousarray(problem.gradient), np.ascontiguousarray(problem.jacobian)
    return solve(DirectionProblem.trusted(g, J, problem.bound, problem.equality))
