"""What training needs of an estimator: a start, then one estimate for each episode of each run."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from cpgrl_opt import Linearization
from cpgrl_opt.arrays import Float, Int

from ..policies import Policy


@dataclass(frozen=True, eq=False)
class Estimate:
    """ρⁱ and Δⁱ of B runs after an episode each, and what the episodes were like. Fresh arrays every time.

    Parameters
    ----------
    values
        (B, 1 + m), ρ per step or per episode, as the estimator's settings say.
    gradients
        (B, 1 + m, n), theirs.
    steps
        (B,), environment steps taken.
    rewards
        (B, 1 + m), each channel's sum over the episode.
    events
        (B,), how the episode ended as the environment counts it, 0 at its time limit.

    Notes
    -----
    An estimator that does not sample has zeros in the last three.
    """

    values: Float[np.ndarray, "B channels"]
    gradients: Float[np.ndarray, "B channels n"]
    steps: Int[np.ndarray, "B"]
    rewards: Float[np.ndarray, "B channels"]
    events: Int[np.ndarray, "B"]

    @property
    def linearization(self) -> Linearization:
        """What a learner takes; ValueError for NaN and infinities."""
        return Linearization(self.values, self.gradients)


@runtime_checkable
class Estimation(Protocol):
    """B runs under way: what is carried from episode to episode lives here.

    `carried`, a class attribute, names the attributes that hold it, so that a training can be saved: arrays, numbers,
    generators, lists of them, objects with names of their own. Without it everything else works.
    """

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """One episode of each run at its own θ, a row of `parameters`."""


@runtime_checkable
class GradientEstimator(Protocol):
    """Settings of an estimator."""

    def start(self, environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence]) -> Estimation:
        """B runs; none must depend on the others.

        Parameters
        ----------
        streams
            The random stream of each run.

        Raises
        ------
        ValueError
            For an environment or a policy that the estimator does not take.
        """
