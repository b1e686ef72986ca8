"""Steps on long gradients: each run in the 1 + m coordinates of its own gradients, where nothing of a step changes.

tangent, restoration, drop rule and limits on the rows of L, K = L Lᵀ        change = a g + Jᵀw, combined once
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .direction import DirectionBatch, DirectionError, Status
from .problem import ProblemBatch
from .reduction import RUNGS, coordinates
from .scaling import lengths
from .step_result import StepResult
from .vectors import Vectors

# The coordinates of rows at an angle θ are rounded, which tilts them by eps/θ, and nothing mends a step as a solve is
# mended: 1e-4 rad leave 1e-12 of it.
_CLEAR_ROWS = 1e-8

OnRows = Callable[..., StepResult]  # (gradients, slack, active, observe)


def step_in_span(
    on_rows: OnRows,
    vectors: Sequence[Vectors],
    slack: np.ndarray,
    active: np.ndarray,
    step_size: float,
    observe: Any,
) -> list[StepResult]:
    """A `StepResult` for each run, in the order of their indices; `observe` sees the subproblems in coordinates."""
    runs = zip(np.ndindex(slack.shape[:-1]), vectors, strict=True)
    return [_step_one(on_rows, each, slack[run], active[run], step_size, observe) for run, each in runs]


def _step_one(
    on_rows: OnRows, vectors: Any, slack: np.ndarray, active: np.ndarray, step_size: float, observe: Any
) -> StepResult:
    """By the first rung that is exact enough, else on the rows; DirectionError where there are none."""
    seen: list[tuple[ProblemBatch, DirectionBatch]] = []
    see = None if observe is None else lambda *pair: seen.append(pair)
    for rung in RUNGS:
        small = coordinates(vectors, active, rung, clear=_CLEAR_ROWS)
        if small is None:
            continue
        seen.clear()
        try:
            result = on_rows(np.vstack([small.gradient, small.jacobian]), slack, active.copy(), see)
        except DirectionError:  # the rows may have what their coordinates have not
            continue
        if result.counts["skipped"]:
            continue
        change, certificate = vectors.combine(small.weights(result.change), np.zeros(len(slack)))
        unit = float(lengths(result.change)) + step_size * float(small.lengths[0])
        if small.holds(result.change, certificate, unit):
            for pair in seen:
                observe(*pair)
            # Of rows that are off the coordinates know nothing.
            return replace(result, change=change, predicted_slack=slack + certificate.products)
    if not vectors.has_rows:
        raise DirectionError(str(Status.UNCERTIFIED))
    result = on_rows(np.vstack([vectors.whole_gradient(), vectors.whole_jacobian()]), slack, active, observe)
    return replace(result, change=vectors.from_row(result.change))
