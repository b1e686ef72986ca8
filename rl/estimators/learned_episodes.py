"""Episodes and their updates as compiled code leaves them: many in one call, shown when somebody looks."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from cpgrl_opt.arrays import Bool, Float, Int
from cpgrl_opt.step import usual_result

from ..learners import CPGRL, LearnerUpdate
from .interface import Estimate


@dataclass(frozen=True, eq=False)
class LearnedEpisodes:
    """Episodes k = 0 … K − 1 of B runs, an update of `CPGRL` after each of the first `made`.

    parameters: (K + 1, B, n), θ before the first episode and after each update; steps, events: (B,), of every episode;
    all others as in `Estimate` and `StepResult`, with K in front. Where made < K, episode `made` was simulated, but its
    update is for `CPGRL.update` to make, and what follows is not there.
    """

    made: int
    parameters: Float[np.ndarray, "K+1 B n"]
    values: Float[np.ndarray, "K B channels"]
    gradients: Float[np.ndarray, "K B channels n"]
    rewards: Float[np.ndarray, "K B channels"]
    active: Bool[np.ndarray, "K B m"]
    flat: Int[np.ndarray, "K B"]
    change: Float[np.ndarray, "K B n"]
    steps: Int[np.ndarray, "B"]
    events: Int[np.ndarray, "B"]

    def estimate(self, k: int) -> Estimate:
        """What episode k was like."""
        values, gradients, rewards = (part[k].copy() for part in (self.values, self.gradients, self.rewards))
        return Estimate(values, gradients, self.steps.copy(), rewards, self.events.copy())

    def update(self, k: int) -> LearnerUpdate:
        """The update after it."""
        return CPGRL.update_of(usual_result(*(part[k].copy() for part in (self.change, self.active, self.flat))))


@runtime_checkable
class LearningEstimation(Protocol):
    """An estimation that can make updates too."""

    def learned_episodes(
        self, parameters: Float[np.ndarray, "B n"], step: tuple[Any, ...], most: int
    ) -> LearnedEpisodes | None:
        """Up to `most` episodes, with an update after each, in one compiled call; None where it cannot yet.

        step: the thresholds, the settings of `move_parameters`, and how far an update may move a component of θ.
        """
