"""The numbers behind the claims of three_state_claims: learning curves read at the paper's moments."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cpgrl_opt.arrays import Float

from .learning_curves import LearningCurves, spread

SETTLED = 1000  # "after 1 × 10³-th episode"
TIGHT = 0.01  # reward per step: the level at which times until the constraints are satisfied are compared


@dataclass(frozen=True, eq=False)
class Evidence:
    """Learning curves of "cpgrl", "conb", "sum", at least two records each, and what they are held against.

    optimum: (1 + m,), exact; thresholds: (m,); objective_share: share of CONB's updates that went along Δ¹.
    """

    curves: Mapping[str, LearningCurves]
    optimum: Float[np.ndarray, "channels"]
    thresholds: Float[np.ndarray, "m"]
    objective_share: float

    def final(self, method: str) -> Float[np.ndarray, "R channels"]:
        """Exact averages of the last policies."""
        return self.curves[method].exact[:, -1]

    def moment(self, episode: int) -> int:
        """The first record at or after this episode; the last one of a shorter training."""
        learned = self.curves["cpgrl"]
        return int(learned.episodes[learned.since(episode)][0])

    def violation(self, method: str, episode: int) -> float:
        """The largest mean violation over the runs from this episode on."""
        learned = self.curves[method]
        return float(learned.violation(self.thresholds)[:, learned.since(episode)].mean(axis=0).max())

    def satisfied_from(self, method: str) -> float:
        """The episode, mean over the runs, from which on every record is within TIGHT of feasible.

        A run that never is counts as if it were at the record after its last.
        """
        learned = self.curves[method]
        beyond = learned.violation(self.thresholds) > TIGHT
        last = np.where(beyond.any(axis=1), beyond.shape[1] - beyond[:, ::-1].argmax(axis=1), 0)
        after = 2 * learned.episodes[-1] - learned.episodes[-2]
        return float(np.append(learned.episodes, after)[last].mean())

    def mean_spread(self, method: str, kind: str) -> Float[np.ndarray, "channels"]:
        """Standard deviation over the runs of "exact" or "estimated", averaged over the records since SETTLED."""
        learned = self.curves[method]
        values: Float[np.ndarray, "R E channels"] = getattr(learned, kind)[:, learned.since(SETTLED)]
        return np.asarray(spread(values).mean(axis=0))

    def probabilities(self, method: str) -> Float[np.ndarray, "S A"]:
        """The last policies, mean over the runs."""
        mean: Float[np.ndarray, "S A"] = self.curves[method].policies[:, -1].mean(axis=0)
        return mean
