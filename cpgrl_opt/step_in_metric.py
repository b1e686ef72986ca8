"""Steps in an operator's metric: each run in the few coordinates of its own gradients, which `flat_span` finds.

Rows that are not active cost no product: their coordinates are 0.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from .direction import DirectionError, Status
from .flat_span import SpanFlat
from .metric_operator import OperatorMetric
from .problem import DirectionProblem
from .step_result import StepResult, skipped_result


def step_in_operator_metric(
    on_rows: Callable[..., StepResult],
    gradients: np.ndarray,
    slack: np.ndarray,
    active: np.ndarray,
    metric: OperatorMetric,
    observe: Any,
    *,
    raises: bool,
    takes_all: bool,
) -> list[StepResult]:
    """A `StepResult` for each run; skipped where M⁻¹ is not reached, or DirectionError where that raises.

    takes_all: the formulation does, so that `active` says what has a multiplier.
    """
    found = []
    for run in np.ndindex(slack.shape[:-1]):
        g, J = np.ascontiguousarray(gradients[run][0]), np.ascontiguousarray(gradients[run][1:])
        bound = np.where(active[run], 0.0, -np.inf)
        problem = DirectionProblem.trusted(g, J, bound, np.zeros(len(bound), np.bool_))
        vars(problem).update(metric=metric.product, whitening=metric)
        span = SpanFlat.of(problem)
        if span.failure is not None:
            if raises:
                raise DirectionError(f"{Status(span.failure)} (the metric: raise metric_iterations)")
            on = np.zeros_like(active[run]) if takes_all else active[run].copy()
            found.append(skipped_result(np.zeros(len(g)), slack[run], on))
            continue
        flat = span.problem
        result = on_rows(np.vstack([flat.gradient, flat.jacobian]), slack[run], active[run].copy(), observe)
        change = span.outside(result.change, slack[run], 0.0)[0]
        found.append(replace(result, change=change, predicted_slack=slack[run] + J @ change))
    return found
