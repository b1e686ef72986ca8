"""The compiled kernels, and how problems are handed to them."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from ..direction import Direction, DirectionBatch, Status
from ..problem import DirectionProblem, ProblemBatch

_STATUSES = tuple(Status)


@cache
def compiled_kernels() -> Any:
    """The package `compiled`, imported when first needed."""
    from . import compiled

    return compiled


def compile_kernels(*, thorough: bool = True) -> None:
    """Compiles the kernels, or loads them from the disk cache, now rather than when there is work enough for it.

    thorough: also the one for hard and infeasible problems, which takes 10 s to compile.
    """
    compiled_kernels().load(thorough=thorough)


def solve_single(
    kernel: Callable[..., tuple[int, int, float]], problem: DirectionProblem, tolerance: float
) -> Direction:
    """One problem by a kernel. Every microsecond here is a good part of the time of a whole solve."""
    jacobian = problem.jacobian
    m, n = jacobian.shape
    value, multipliers = np.empty(n), np.empty(m)
    status, iterations, _ = kernel(
        problem.gradient, jacobian, problem.bound, problem.equality, tolerance, value, multipliers
    )
    return Direction.found(value, multipliers, _STATUSES[status], iterations, "rows")


def solve_stacked(
    kernel: Callable[..., None], problems: ProblemBatch | Sequence[DirectionProblem], tolerance: float
) -> DirectionBatch:
    """B problems of one shape in one call of a batch kernel."""
    stacked = ProblemBatch.stack(problems)
    count, m = stacked.bound.shape
    answer = DirectionBatch(
        np.empty(stacked.gradient.shape),
        np.empty((count, m)),
        np.empty(count, dtype=np.int64),
        np.empty(count, dtype=np.int64),
    )
    kernel(
        stacked.gradient,
        stacked.jacobian,
        stacked.bound,
        stacked.equality,
        tolerance,
        answer.value,
        answer.multipliers,
        answer.status,
        answer.iterations,
    )
    return answer
