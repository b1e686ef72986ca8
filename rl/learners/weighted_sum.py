"""SUM, the unconstrained method that the paper compares with (§3.1)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpgrl_opt import Linearization
from cpgrl_opt.arrays import Float
from cpgrl_opt.step import Observer
from cpgrl_opt.validation import real_values, require_shape

from .interface import LearnerUpdate
from .settings import require_step_size


@dataclass(frozen=True, init=False, eq=False)
class WeightedSum:
    """θ ← θ + α₁ Σᵢ wᵢ Δⁱ over all channels: the policy gradient of the reward Σᵢ wᵢ rⁱ.

    It knows no constraints: `active` is always false.

    Parameters
    ----------
    weights
        wᵢ, (1 + m,); ones, the paper's, unless given.
    step_size
        α₁ ≥ 0.

    Raises
    ------
    ValueError
        For numbers that are not finite; at an update, for another number of weights than channels.

    Notes
    -----
    Source: §3.1 of the paper, SUM.
    """

    weights: Float[np.ndarray, "channels"] | None
    step_size: float

    def __init__(self, weights: ArrayLike | None = None, *, step_size: float = 0.02) -> None:
        vector = None if weights is None else real_values("weights", weights).copy()
        if vector is not None and (vector.ndim != 1 or not np.isfinite(vector).all()):
            raise ValueError(f"weights should be finite numbers, (1 + m,); found {vector.tolist()}")
        object.__setattr__(self, "weights", vector)
        object.__setattr__(self, "step_size", require_step_size(step_size))

    def update(
        self,
        linearization: Linearization,
        memory: Any = None,  # noqa: ARG002 - nothing is remembered
        observe: Observer | None = None,  # noqa: ARG002 - no direction problem is solved
    ) -> LearnerUpdate:
        """The sum's step; ValueError when there are not as many weights as channels."""
        runs, channels = linearization.values.shape
        gradients = linearization.gradients
        if self.weights is not None:
            require_shape("weights", self.weights, (channels,))
            gradients = self.weights[:, None] * gradients
        change = self.step_size * gradients.sum(axis=1)
        active = np.zeros((runs, channels - 1), dtype=np.bool_)
        return LearnerUpdate(change, active, ~change.any(axis=1))
