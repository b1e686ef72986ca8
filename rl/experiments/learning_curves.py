"""What training leaves behind: average rewards and policies of every run, every so many episodes."""

from dataclasses import dataclass

import numpy as np

from cpgrl_opt.arrays import Float, Int


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


def spread(values: Float[np.ndarray, "R *shape"]) -> Float[np.ndarray, "*shape"]:
    """Standard deviation over the runs, with R − 1; 0 for a single run."""
    if len(values) < 2:
        return np.zeros(values.shape[1:])
    deviation: Float[np.ndarray, "*shape"] = values.std(axis=0, ddof=1)
    return deviation
