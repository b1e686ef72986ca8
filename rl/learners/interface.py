"""What training needs of a learner."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from cpgrl_opt import Linearization
from cpgrl_opt.arrays import Bool, Float, Int
from cpgrl_opt.step import Observer


@dataclass(frozen=True, eq=False)
class LearnerUpdate:
    """The change of θ of B runs and what happened on the way.

    Parameters
    ----------
    change
        (B, n), of θ.
    active
        (B, m), constraints that the learner attended to.
    stationary
        (B,), whether nothing is left to improve, as far as the learner can tell.
    counts
        By name, (B,), events of this update.
    memory
        Handed back to the learner with the next linearization.
    """

    change: Float[np.ndarray, "B n"]
    active: Bool[np.ndarray, "B m"]
    stationary: Bool[np.ndarray, "B"]
    counts: Mapping[str, Int[np.ndarray, "B"]] = field(default_factory=dict)
    memory: Any = None


@runtime_checkable
class Learner(Protocol):
    """Settings of a learner; what it remembers of a run travels in `memory`, None before the first update."""

    def update(
        self, linearization: Linearization, memory: Any = None, observe: Observer | None = None
    ) -> LearnerUpdate:
        """The change for each of B runs, none depending on another; `observe` sees every direction problem."""
