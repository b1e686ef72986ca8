"""The compiled kernels, loaded with the first solve, and how batches are handed to them."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from ..direction import DirectionBatch
from ..problem import DirectionProblem, ProblemBatch


@cache
def compiled_kernels() -> Any:
    """The package `compiled`; imports numba, and compiles or loads from the disk cache what it needs."""
    from . import compiled

    return compiled


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
