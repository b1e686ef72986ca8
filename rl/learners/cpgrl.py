"""CPGRL: constrained policy-gradient reinforcement learning by gradient projection (§2.3)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpgrl_opt import ConstrainedStep, Linearization, StepResult
from cpgrl_opt.arrays import Float
from cpgrl_opt.step import Observer

from .interface import LearnerUpdate
from .settings import threshold_vector


@dataclass(frozen=True, init=False, eq=False)
class CPGRL:
    """θ ← θ + α₁ PΔ¹ − αₑ d, P and d from the active constraints; or what else the step is set to.

    Parameters
    ----------
    step
        Any `ConstrainedStep`, with its solver and formulation.
    thresholds
        Gⁱ, (m,), per environment step.

    Raises
    ------
    ValueError
        For thresholds that are not finite numbers; at an update, for another number of them than constraints.

    Notes
    -----
    Source: eq. 8–10 of the paper.
    """

    step: ConstrainedStep
    thresholds: Float[np.ndarray, "m"]

    def __init__(self, step: ConstrainedStep, thresholds: ArrayLike) -> None:
        object.__setattr__(self, "step", step)
        object.__setattr__(self, "thresholds", threshold_vector(thresholds))

    def update(
        self, linearization: Linearization, memory: Any = None, observe: Observer | None = None
    ) -> LearnerUpdate:
        """The step's change; the memory is its active set."""
        return self.update_of(self.step(linearization, self.thresholds, memory, observe))

    @staticmethod
    def update_of(result: StepResult) -> LearnerUpdate:
        """What the step did, as learners say it."""
        return LearnerUpdate(result.change, result.active, result.stationary, result.counts, result.active)
