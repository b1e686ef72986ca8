"""CPGRL without its projection: what the projection is worth is seen beside this."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpgrl_opt import FORMULATIONS, ConstrainedStep, Linearization
from cpgrl_opt.arrays import Float
from cpgrl_opt.step import Observer

from .interface import LearnerUpdate
from .settings import threshold_vector


@dataclass(frozen=True, init=False, eq=False)
class GradientWithRestoration:
    """θ ← θ + α₁ Δ¹ + αₑ v: CPGRL's restoration v = −d beside the whole gradient, eq. 8 with P = I.

    Ours, for comparison.

    Parameters
    ----------
    step
        A `ConstrainedStep`; its solver, rates and safeguards serve the restoration.
    thresholds
        Gⁱ, (m,).

    Raises
    ------
    ValueError
        For "restoring" and "linearized", whose restoration is no move of its own.
    """

    step: ConstrainedStep
    thresholds: Float[np.ndarray, "m"]
    restoration: ConstrainedStep

    def __init__(self, step: ConstrainedStep, thresholds: ArrayLike) -> None:
        if not isinstance(step, ConstrainedStep):
            raise ValueError(f"step should be a ConstrainedStep; found {step!r}")
        if FORMULATIONS[step.formulation].restores_inside:
            raise ValueError(
                f"formulation should be 'equality' or 'cone', with a restoration apart; found {step.formulation!r}"
            )
        object.__setattr__(self, "step", step)
        object.__setattr__(self, "thresholds", threshold_vector(thresholds))
        object.__setattr__(self, "restoration", replace(step, step_size=0.0))

    def update(
        self, linearization: Linearization, memory: Any = None, observe: Observer | None = None
    ) -> LearnerUpdate:
        """The change; counts are those of the step that restores."""
        result = self.restoration(linearization, self.thresholds, memory, observe)
        change = result.change + self.step.step_size * linearization.objective_gradient
        return LearnerUpdate(change, result.active, np.asarray(~change.any(axis=1)), result.counts, result.active)
