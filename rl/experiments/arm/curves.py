"""What training on the arm leaves behind: touches, violations and lengths of every run, block by block."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from cpgrl_opt.arrays import Float, Int
from envs import TwoLinkArm

from ...training import TrainingRecord
from ..experiment import CaseRecorder

ARM = TwoLinkArm()
OUTCOMES = (*ARM.events, "none")  # of an episode
EARLY = 500  # episodes: "at the early stage of learning"
LATE = 1000  # the last ones, where what was learned is judged


@dataclass(frozen=True, eq=False)
class TouchCurves:
    """R runs of one training in E blocks of episodes.

    arm: what was trained on, its K objects in order; episodes: (E,), the last of each block, from 1; sizes: (E,),
    episodes in each; touches: (R, E, K + 1), episodes by the object that ended them, by none in the last column;
    violation: (R, E), share of steps with r² < 0; length: (R, E), mean episode length, steps.
    """

    arm: TwoLinkArm
    episodes: Int[np.ndarray, "E"]
    sizes: Int[np.ndarray, "E"]
    touches: Int[np.ndarray, "R E outcomes"]
    violation: Float[np.ndarray, "R E"]
    length: Float[np.ndarray, "R E"]

    @property
    def outcomes(self) -> tuple[str, ...]:
        """The objects' names, then "none"."""
        return (*self.arm.events, "none")

    def early(self) -> Self:
        """The first EARLY episodes, or the first half of a shorter training."""
        return self.within(0, min(EARLY, int(self.episodes[-1]) // 2))

    def late(self) -> Self:
        """The last LATE episodes, or the last tenth of a training shorter than ten times that."""
        last = int(self.episodes[-1])
        return self.within(last - min(LATE, last // 10), last)

    def within(self, first: int, last: int) -> Self:
        """Blocks that lie in first + 1 … last; if none does, the one in which `last` falls, or the final one.

        So a moment that a short training does not reach is its last one.
        """
        chosen = (self.episodes - self.sizes >= first) & (self.episodes <= last)
        if not chosen.any():
            chosen[min(int(np.searchsorted(self.episodes, last)), len(chosen) - 1)] = True
        return type(self)(
            self.arm, self.episodes[chosen], self.sizes[chosen],
            self.touches[:, chosen], self.violation[:, chosen], self.length[:, chosen],
        )  # fmt: skip

    def per_hundred(self) -> Float[np.ndarray, "R E outcomes"]:
        """Touches per 100 episodes in each block."""
        rates: Float[np.ndarray, "R E outcomes"] = 100 * self.touches / self.sizes[:, None]
        return rates

    def rates(self) -> Float[np.ndarray, "R outcomes"]:
        """Touches per 100 episodes over all blocks."""
        return np.asarray(100 * self.touches.sum(axis=1) / self.sizes.sum())

    def mean_rates(self) -> dict[str, float]:
        """The same by outcome, mean over the runs."""
        rates = self.rates()
        return {outcome: float(rates[:, k].mean()) for k, outcome in enumerate(self.outcomes)}

    def outside(self) -> Float[np.ndarray, "R"]:
        """Share of steps outside the box of r², that is −ρ²."""
        steps = self.length * self.sizes
        return np.asarray((self.violation * steps).sum(axis=1) / steps.sum(axis=1))

    def average_r3(self, unit: str) -> Float[np.ndarray, "R"]:
        """ρ³ over all blocks, per "step" or per "episode"."""
        rewards = np.array([*(thing.reward for thing in self.arm.objects), 0.0])
        total = (self.touches @ rewards).sum(axis=1)
        count = (self.length * self.sizes).sum(axis=1) if unit == "step" else self.sizes.sum()
        return np.asarray(total / count)


class TouchRecorder(CaseRecorder):
    """By what the episodes since the last record ended, and their steps, outside the box of r² and all."""

    carried = ("touches", "steps", "outside", "size")

    def __init__(self, runs: int) -> None:
        self.runs = np.arange(runs)
        self._begin()

    def _begin(self) -> None:
        self.touches = np.zeros((len(self.runs), len(OUTCOMES)), dtype=np.int64)
        self.steps, self.outside = np.zeros((2, len(self.runs)))
        self.size = 0

    def see(self, record: TrainingRecord) -> Mapping[str, np.ndarray]:
        """Counts "constrained": updates with an active constraint, in each of which the ridge acts."""
        estimate = record.estimate
        self.touches[self.runs, estimate.events - 1] += 1  # a time-out, event 0, in the last column
        self.steps += estimate.steps
        self.outside -= estimate.rewards[:, 1]  # r² = −1 outside the box, else 0
        self.size += 1
        return {"constrained": np.asarray(record.update.active.any(axis=1), dtype=np.int64)}

    def values(self) -> dict[str, np.ndarray]:
        """As in TouchCurves."""
        found = {
            "touches": self.touches,
            "violation": self.outside / self.steps,
            "length": self.steps / self.size,
        }
        self._begin()
        return found
