"""The compiled kernels, loaded with the first solve, and how problems are handed to them."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from ..direction import Direction, DirectionBatch, Status
from ..problem import DirectionProblem, ProblemBatch

_STATUSES = tuple(Status)


@cache
def compiled_kernels() -> Any:
    """The package `compiled`; imports numba, and compiles or loads from the disk cache what it needs."""
    from . import compiled

    return compiled


def compile_kernels() -> None:
    """Compiles every kernel, or loads it from the disk cache, now rather than with the first problem that needs it."""
    compiled_kernels().load()


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
    return Direction(value, multipliers, _STATUSES[status], iterations)


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
