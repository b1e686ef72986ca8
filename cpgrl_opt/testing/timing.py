"""The law of time: no problem is answered out of all proportion to others of its shape."""

import time
from contextlib import suppress
from statistics import median

import numpy as np

from ..problem import DirectionProblem
from ..solvers.interface import DirectionSolver
from .law import LawError, NothingClaimed, answer_of, law, length, skip_unless, takes, vary, whitened

# A pause of a solver at some problems is a third of a second or so, a stall of a busy machine a tenth; from 0.1 s on it
# is measured again, so at 0.01 s a stall would cost time, and at 1 s a pause would pass.
_UNNOTICED = 0.1  # s
_FOR_EACH_SET = 5e-4  # s, for each set of rows: 2ᵐ of them are what methods of finite end try at worst
_TIMES_USUAL = 50.0
_ATTEMPTS = 4
_OTHERS = 5


@law
def check_time_is_in_proportion(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """No answer takes longer than 0.1 s, 2ᵐ · 0.5 ms and 50 times the median of its shape, whichever is the longest.

    The median is that of ordinary problems. The least of four attempts counts, so that neither a first call, which may
    import and compile, nor a busy machine breaks it. Source: a step in a training loop waits for the slowest of its
    problems.
    """
    least = _seconds(solver, problem)
    floor = max(_UNNOTICED, _FOR_EACH_SET * 2.0**problem.m)
    if least <= floor:
        return
    others = [other for other in _ordinary(problem) if takes(solver, other)]
    skip_unless(bool(others))
    limit = floor
    for _ in range(_ATTEMPTS - 1):
        limit = max(limit, _TIMES_USUAL * median(_seconds(solver, other) for other in others))
        least = min(least, _seconds(solver, problem))
        if least <= limit:
            return
    raise LawError(
        f"an answer should take at most {limit:.3g} s here, 50 times the median of ordinary problems of this shape; "
        f"found {least:.3g} s at the least of {_ATTEMPTS} attempts. Is there a pause, a retry or a timeout in its way?",
        problem,
    )


def _seconds(solver: DirectionSolver, problem: DirectionProblem) -> float:
    """By the clock: a solver that sleeps uses no processor."""
    start = time.perf_counter()
    with suppress(NothingClaimed):
        answer_of(solver, problem)
    return time.perf_counter() - start


def _ordinary(problem: DirectionProblem) -> list[DirectionProblem]:
    """Random problems of the same shape, equalities and geometry, feasible, with bounds where it has some."""
    m, n, others = problem.m, problem.n, []
    rng = np.random.default_rng([n, m])
    for _ in range(_OTHERS):
        jacobian, point = rng.normal(size=(m, n)), rng.normal(size=n)
        if problem.radius is not None:
            point *= 0.5 * problem.radius / (length(whitened(problem, point)) or 1.0)
        slack = np.where(problem.equality, 0.0, rng.exponential(size=m))
        bound = jacobian @ point - slack if problem.bound.any() else np.zeros(m)
        others.append(vary(problem, gradient=rng.normal(size=n), jacobian=jacobian, bound=bound))
    return others
