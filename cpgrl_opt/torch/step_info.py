"""What happened in an update, by the names of the constraints."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..direction import DirectionError, KKTResiduals, Status
from ..step_result import StepResult


@dataclass(frozen=True, eq=False)
class StepInfo:
    """The proof of an update; each of the first four is a dict by name where the constraints were named, else (m,).

    multipliers μ: the change descends ∇loss + Σ μᵢ∇costᵢ, with rewards −∇rewardᵢ in the place of ∇costᵢ; ≥ 0 at an
        optimum, but of equalities (`formulation="equality"`). Of INFEASIBLE a proof that nothing meets the constraints.
    active: the constraints that the step looked at; with `linearized` those with μ > 0.
    slack: threshold − cost, or reward − threshold; ≥ 0 is feasible. predicted_slack: after the change, to first order.
    residuals: of the certificate, None where there is none.
    status: OPTIMAL; INFEASIBLE where nothing meets the constraints, so that they are violated least; UNCERTIFIED where
        nothing moves; NUMERICAL_ERROR where a gradient overflows under a scaler, which then skips the step.
    stationary: no direction is better. counts: of `StepResult`.
    """

    multipliers: Any
    active: Any
    slack: Any
    predicted_slack: Any
    residuals: KKTResiduals | None
    status: Status
    stationary: bool
    counts: dict[str, int]
    previous: np.ndarray = field(repr=False)  # `active` as a step takes it

    def raise_for_status(self) -> None:
        """DirectionError with the status' advice unless it is OPTIMAL."""
        if self.status != Status.OPTIMAL:
            raise DirectionError(str(self.status))

    @classmethod
    def of(cls, names: tuple[Any, ...] | None, *numbers: Any, status: Status, **others: Any) -> "StepInfo":
        """By name where there are names; numbers: multipliers, active, slack, predicted slack."""
        given: dict[str, Any] = {"residuals": None, "stationary": False, "counts": {}, **others}
        for name, each in zip(("multipliers", "active", "slack", "predicted_slack"), numbers, strict=True):
            given[name] = each if names is None else dict(zip(names, np.asarray(each).tolist(), strict=True))
        return cls(status=status, previous=np.asarray(numbers[1]), **given)


def describe(result: StepResult, slack: np.ndarray, names: tuple[Any, ...] | None) -> StepInfo:
    """Of one run's result."""
    counts = {name: int(count) for name, count in result.counts.items()}
    status = Status.UNCERTIFIED if counts["skipped"] else Status.INFEASIBLE if counts["infeasible"] else Status.OPTIMAL
    residuals = result.residuals
    has_proof = residuals is not None and not np.isnan(residuals).any()
    return StepInfo.of(
        names,
        result.multipliers,
        result.active,
        slack,
        result.predicted_slack,
        status=status,
        residuals=KKTResiduals(*np.asarray(residuals).tolist()) if has_proof else None,
        stationary=bool(result.stationary),
        counts=counts,
    )
