"""Steps in the 1 + m coordinates of one run's own gradients, where nothing of a step changes.

tangent, restoration, drop rule and limits on the rows of L, K = L Lᵀ        change = a g + Jᵀw, combined once

K = V Vᵀ for long gradients, K = V M⁻¹ Vᵀ in an operator's metric. Both raise DirectionError where K does not tell.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from .direction import DirectionBatch, DirectionError, Status
from .metric_operator import OperatorMetric, Span
from .problem import ProblemBatch
from .reduction import RUNGS, coordinates
from .scaling import lengths
from .step_result import StepResult

# The coordinates of rows at an angle θ are rounded, which tilts them by eps/θ, and nothing mends a step as a solve is
# mended: 1e-4 rad leave 1e-12 of it.
_CLEAR_ROWS = 1e-8

OnRows = Callable[..., StepResult]  # (gradients, slack, active, observe); it may write to `active`


def step_in_span(
    on_rows: OnRows, vectors: Any, slack: np.ndarray, active: np.ndarray, step_size: float, observe: Any
) -> StepResult:
    """By the first rung that is exact enough, else on the rows, if there are any; `observe` sees what it is made of."""
    seen: list[tuple[ProblemBatch, DirectionBatch]] = []
    see = None if observe is None else lambda *pair: seen.append(pair)
    result: StepResult = vectors.attempt(_step_in_span, on_rows, vectors, slack, active, step_size, seen, see)
    for pair in seen:  # after the last message, since what an observer raises is of its own process alone
        observe(*pair)
    return result


def _step_in_span(
    on_rows: OnRows, vectors: Any, slack: np.ndarray, active: np.ndarray, step_size: float, seen: list[Any], see: Any
) -> StepResult:
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
            # Of rows that are off the coordinates know nothing.
            return replace(result, change=change, predicted_slack=slack + certificate.products)
    if not vectors.has_rows:
        raise DirectionError(str(Status.UNCERTIFIED))
    seen.clear()
    result = on_rows(np.vstack([vectors.whole_gradient(), vectors.whole_jacobian()]), slack, active, see)
    return replace(result, change=vectors.from_row(result.change))


def step_in_metric(
    on_rows: OnRows, vectors: Any, slack: np.ndarray, active: np.ndarray, metric: OperatorMetric, observe: Any
) -> StepResult:
    """In the metric of v ↦ Mv. Rows that are not active cost no product: their coordinates are 0."""
    g, J = (np.ascontiguousarray(whole) for whole in (vectors.whole_gradient(), vectors.whole_jacobian()))
    span = Span.of(metric, g, J, active)
    if span.failure is not None:
        raise DirectionError(f"{Status(span.failure)} (the metric: raise metric_iterations)")
    result = on_rows(span.rows, slack, active.copy(), observe)
    change = span.original(result.change)
    return replace(result, change=change, predicted_slack=slack + J @ change)
