"""Values and gradients of all reward channels at θ: what a gradient estimator hands to a step."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .arrays import ArrayLike, Float
from .metric import Whitening
from .validation import is_finite, real_values, require_finite, require_shape
from .vectors import ArrayVectors, is_long


@dataclass(frozen=True, init=False, eq=False)
class Linearization:
    """gⁱ(θ + d) ≈ ρⁱ + (Δⁱ)ᵀd for every reward channel i = 1 … 1 + m.

    Channel 0 of the arrays is the objective r¹; channels 1 … m are the constraints r², r³, …. The arrays
    may carry leading axes, one linearization for each of many independent runs. Gradients are ascent gradients.

    values: (…, 1 + m), average rewards per step; gradients: (…, 1 + m, n), policy gradients of the same. Neither is
    copied if it is a float64 array already.
    Raises ValueError for NaN, infinities, shapes that do not belong together.
    Source: §2.1–2.2 of the paper (ρⁱ and Δⁱ).
    """

    values: Float[np.ndarray, "*runs channels"]
    gradients: Float[np.ndarray, "*runs channels n"]

    def __init__(self, values: ArrayLike, gradients: ArrayLike) -> None:
        # Not copied: an estimator makes fresh arrays for every episode, and a copy each would cost more than a step.
        values, gradients = real_values("values", values), real_values("gradients", gradients)
        if gradients.ndim < 2:
            raise ValueError(f"gradients should have shape (…, 1 + m, n); found {gradients.shape}")
        require_finite("values", values)
        require_shape("values", values, gradients.shape[:-1])
        if values.shape[-1] == 0:
            raise ValueError("values should have at least the objective's channel; found none")
        vars(self).update(values=values, gradients=gradients)
        if not (self.is_long and all(vectors.are_finite() for vectors in self.vectors)):
            require_finite("gradients", gradients)

    def __reduce__(self) -> tuple[type["Linearization"], tuple[object, ...]]:
        # Without the vectors, which are the gradients once more.
        return Linearization, (self.values, self.gradients)

    @property
    def is_long(self) -> bool:
        """Whether a step first reduces the gradients to their span."""
        channels, n = self.gradients.shape[-2:]
        return is_long(channels - 1, n)

    @cached_property
    def vectors(self) -> tuple[ArrayVectors, ...]:
        """The gradients of each run, in the order of their indices; they keep their inner products."""
        runs = np.ndindex(self.gradients.shape[:-2])
        return tuple(ArrayVectors(self.gradients[run][0], self.gradients[run][1:]) for run in runs)

    @property
    def objective_gradient(self) -> Float[np.ndarray, "*runs n"]:
        """Δ¹."""
        return self.gradients[..., 0, :]

    @property
    def jacobian(self) -> Float[np.ndarray, "*runs m n"]:
        """Constraint gradients Δ², Δ³, … as rows: Nᵀ of the paper."""
        return self.gradients[..., 1:, :]

    def whitened(self, whitening: Whitening) -> "Linearization":
        """The same in the coordinates where M = LLᵀ is I, the gradients JL⁻ᵀ; ValueError where one overflows.

        Run by run, since the bits of many rows solved at once depend on their number.
        """
        gradients = np.empty(self.gradients.shape)
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            for run in np.ndindex(gradients.shape[:-2]):
                gradients[run] = whitening.rows(self.gradients[run])
        if not is_finite(gradients):
            raise ValueError(
                "gradients should be finite where the metric is the identity, JL⁻ᵀ of M = LLᵀ; found one that overflows"
            )
        return Linearization(self.values, gradients)

    def slack(self, thresholds: Float[np.ndarray, "m"]) -> Float[np.ndarray, "*runs m"]:
        """ρⁱ − Gⁱ of the constraints; ≥ 0 is feasible."""
        slack: np.ndarray = self.values[..., 1:] - thresholds
        return slack
