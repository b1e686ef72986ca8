"""Problems in a metric, and in a ball that meets their constraints, touches or misses them.

A ball's radius is a multiple of the length of the shortest direction that meets the constraints.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..problem import DirectionProblem
from .assembly import vary
from .case import Case
from .infeasible import infeasible
from .regular import ordinary
from .source import Source

Make = Callable[[Source, Case], DirectionProblem]

# Radii, in units of the length of the shortest direction; the huge ones are as people write "none".
HUGE = (1e3, 1e6)
REACHING = (2.0, 1.25, 8.0, *HUGE)
MISSING = (0.5, 0.125)
# A few digits from touching: κ is as large as their root is small.
TOUCHING = (1.0, 1.0 + 1e-3, 1.0 + 1e-6, 1.0 + 1e-9)


def in_metric(source: Source, case: Case, *, of: Make = ordinary, is_full: bool | None = None) -> DirectionProblem:
    """Any problem, in a metric."""
    return with_metric(source, of(source, case), is_full=is_full)


def in_ball(
    source: Source, case: Case, *, of: Make = ordinary, factors: tuple[float, ...] = REACHING
) -> DirectionProblem:
    """Any problem, in a ball and perhaps a metric."""
    return with_radius(source, with_metric_perhaps(source, of(source, case)), factors)


def out_of_reach(source: Source, case: Case, *, factors: tuple[float, ...] = MISSING) -> DirectionProblem:
    """The constraints ask for something, and the ball ends half way to it at most, or where `factors` say."""
    problem = ordinary(source, case)
    asks = np.where(problem.equality, problem.bound != 0, problem.bound > 0).any()
    if not asks:  # ask for something that is there
        J, b = problem.jacobian.copy(), np.where(problem.equality, 0.0, -np.inf)
        if J[0] @ np.ones(problem.n) == 0:
            J[0] = 1.0
        J[1:], b[0] = 0.0, 7.0
        problem = vary(problem, jacobian=J, bound=b)
    return with_radius(source, with_metric_perhaps(source, problem), factors)


def infeasible_in_huge_ball(source: Source, case: Case, **settings: Any) -> DirectionProblem:
    """Rows that contradict each other; the radius is somebody's word for "none"."""
    problem = infeasible(source, case, **settings)
    return vary(problem, radius=1e12 * math.exp(source.uniform(-1.0, 1.0)))


def with_metric_perhaps(source: Source, problem: DirectionProblem) -> DirectionProblem:
    """The problem, in a metric half of the time."""
    return with_metric(source, problem) if source.choice((False, True)) else problem


def with_metric(source: Source, problem: DirectionProblem, *, is_full: bool | None = None) -> DirectionProblem:
    """The problem in a metric, a diagonal or a full one."""
    full = source.choice((False, True)) if is_full is None else is_full
    return vary(problem, metric=source.metric(problem.n, is_full=full))


def with_radius(source: Source, problem: DirectionProblem, factors: tuple[float, ...]) -> DirectionProblem:
    """The problem in a ball of some factor times what the shortest direction needs; of any size where that is 0."""
    factor = source.choice(factors)
    return vary(problem, radius=factor * (source.shortest(problem) or source.choice((1.0, 0.25, 5.0))))
