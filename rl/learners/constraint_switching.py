"""CONB, the constraints-based method that the paper compares with (§3.1)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpgrl_opt import Linearization
from cpgrl_opt.arrays import Float
from cpgrl_opt.step import Observer
from cpgrl_opt.validation import require_nonnegative, require_shape

from .interface import LearnerUpdate
from .settings import require_step_size, threshold_vector


@dataclass(frozen=True, init=False, eq=False)
class ConstraintSwitching:
    """θ ← θ + α₁ Δ¹ if ρⁱ − Gⁱ > −η for all i, else θ + α₁ Δʲ, j = argmin ρⁱ − Gⁱ.

    Where some rewards sum to 0 and their thresholds are 0, as in the three-state MDP, the first case never holds
    without a tolerance (docs/reproduction.md, slip 6).

    Parameters
    ----------
    thresholds
        Gⁱ, (m,), per environment step.
    step_size
        α₁ ≥ 0.
    tolerance
        η ≥ 0, in the unit of the thresholds: 0 in the paper.

    Raises
    ------
    ValueError
        For numbers that are not finite or below 0; at an update, for another number of thresholds than constraints.

    Notes
    -----
    Source: §3.1 of the paper, CONB; the tolerance is ours, as in CRPO (2021).
    """

    thresholds: Float[np.ndarray, "m"]
    step_size: float
    tolerance: float

    def __init__(self, thresholds: ArrayLike, *, step_size: float = 0.02, tolerance: float = 0.0) -> None:
        require_nonnegative("tolerance", tolerance)
        object.__setattr__(self, "thresholds", threshold_vector(thresholds))
        object.__setattr__(self, "step_size", require_step_size(step_size))
        object.__setattr__(self, "tolerance", float(tolerance))

    def update(
        self,
        linearization: Linearization,
        memory: Any = None,  # noqa: ARG002 - nothing is remembered
        observe: Observer | None = None,  # noqa: ARG002 - no direction problem is solved
    ) -> LearnerUpdate:
        """One gradient's step; counts `objective`, the updates along Δ¹."""
        require_shape("thresholds", self.thresholds, linearization.jacobian.shape[1:2])
        slack = linearization.slack(self.thresholds)
        active = np.less_equal(slack, -self.tolerance, dtype=np.bool_)
        violated = active.any(axis=1)
        # channel 0 is Δ¹, channel j + 1 the j-th constraint; without constraints there is nothing to switch to
        channel = np.where(violated, slack.argmin(axis=1) + 1 if slack.shape[1] else 0, 0)
        change: np.ndarray = self.step_size * linearization.gradients[np.arange(len(slack)), channel]
        stationary = np.asarray(~change.any(axis=1))
        return LearnerUpdate(change, active, stationary, {"objective": np.asarray(~violated, dtype=np.int64)})
