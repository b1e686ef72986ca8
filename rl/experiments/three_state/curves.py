"""What training leaves behind: average rewards and policies of every run, every so many episodes."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cpgrl_opt.arrays import Float, Int
from envs import ThreeStateMDP

from ...policies import SoftmaxTable
from ...training import Training, TrainingRecord
from ..experiment import CaseRecorder

MDP = ThreeStateMDP()


@dataclass(frozen=True, eq=False)
class LearningCurves:
    """R runs of one method at E recorded moments; row k stands for the policy after `episodes[k]` updates.

    episodes: (E,), from 0 to the last update; estimated: (R, E, 1 + m), ρ as it is carried, so from the episode before
    the last update; exact: (R, E, 1 + m), the true averages of the policy; policies: (R, E, S, A).
    """

    episodes: Int[np.ndarray, "E"]
    estimated: Float[np.ndarray, "R E channels"]
    exact: Float[np.ndarray, "R E channels"]
    policies: Float[np.ndarray, "R E S A"]

    def since(self, episode: int) -> slice:
        """The records from this episode on; the last one if training was shorter."""
        return slice(min(int(np.searchsorted(self.episodes, episode)), len(self.episodes) - 1), None)

    def violation(self, thresholds: Float[np.ndarray, "m"]) -> Float[np.ndarray, "R E"]:
        """max_i (Gⁱ − ρⁱ)₊ of the exact averages: 0 where all constraints are satisfied."""
        below: Float[np.ndarray, "R E"] = (thresholds - self.exact[:, :, 1:]).max(axis=2, initial=0.0)
        return below


class AveragesRecorder(CaseRecorder):
    """ρ as it is carried, the exact averages of the policy after the update, and the policy."""

    def __init__(self, training: Training) -> None:
        self.parameters = training.parameters
        self.estimated: np.ndarray | None = None

    def see(self, record: TrainingRecord) -> Mapping[str, np.ndarray]:
        """Nothing to count."""
        self.parameters, self.estimated = record.parameters, record.estimate.values
        return {}

    def values(self) -> dict[str, np.ndarray]:
        """Before the first update ρ is 0."""
        exact, policies = exact_averages(self.parameters)
        estimated = np.zeros_like(exact) if self.estimated is None else self.estimated
        return {"estimated": estimated, "exact": exact, "policies": policies}


def exact_averages(parameters: Float[np.ndarray, "R n"]) -> tuple[np.ndarray, np.ndarray]:
    """The averages (R, 1 + m) of policies, and these (R, S, A).

    Parameters
    ----------
    parameters
        (R, 9): θ of each run.

    Returns
    -------
    tuple of arrays
        Average rewards per step (R, 1 + m); policies (R, S, A).
    """
    policies = SoftmaxTable(MDP.states, MDP.actions).probabilities(parameters)
    return MDP.average_rewards(policies), policies
