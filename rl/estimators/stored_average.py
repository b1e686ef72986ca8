"""Average rewards that outlive an episode (§2.4)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

AVERAGES = ("step", "episode")


class MeanWeight:
    """γ_k = α / (1 − (1 − α)ᵏ) of the k-th number in the mean M ← M + γ_k (x_k − M), which is Σ_j (1 − α)^{k−j} x_j
    divided by the sum of its weights.

    M is x_1 after the first number, the plain mean as long as k ≪ 1/α, and remembers about 1/α numbers later on; with
    α = 0 it stays the plain mean. M is exactly x where all numbers are x, as γ_1 is exactly 1.
    """

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self.count = 0
        self.total = 0.0  # 1 − (1 − α)ᵏ, by the same recursion: a difference of powers would lose digits at small α

    def next(self) -> float:
        """γ_k for the next k, from 1 on."""
        self.count += 1
        self.total += self.rate * (1.0 - self.total)
        return self.rate / self.total if self.rate > 0 else 1.0 / self.count


@dataclass(frozen=True, init=False, eq=False)
class StoredAverage:
    """ρⁱ of B runs: stored at the end of an episode, the starting value in the next.

        "step"      ρⁱ ← ρⁱ + α_r (rⁱ_t − ρⁱ)    at every step (eq. 4), in reward per step
        "episode"   ρⁱ ← ρⁱ + α_r (Σ_t rⁱ_t − ρⁱ)    at the end of every episode, in reward per episode

    Our reading: §2.4, on backups of the averages, breaks off in our copy, and "episode" is ours alone. A channel's
    kind decides which average it shows to the learner, and so the unit of its threshold. Eq. 4 is kept for every
    channel all the same, since each critic subtracts it.

    average: a kind for all channels, or one for each. per_step: (B, 1 + m), which the estimator advances in place;
    per_episode: (B, 1 + m). Both from 0. Raises ValueError for other kinds, or not as many as channels.
    """

    rate: float
    by_episode: Bool[np.ndarray, "channels"]
    per_step: Float[np.ndarray, "B channels"]
    per_episode: Float[np.ndarray, "B channels"]
    any_by_episode: bool

    def __init__(self, average: str | Sequence[str], rate: float, runs: int, channels: int) -> None:
        kinds = (average,) * channels if isinstance(average, str) else tuple(average)
        require_averages(kinds)
        if len(kinds) != channels:
            raise ValueError(f"average should be one kind, or {channels}, one for each channel; found {len(kinds)}")
        for name, value in (
            ("rate", float(rate)),
            ("by_episode", np.array([kind == "episode" for kind in kinds])),
            ("any_by_episode", "episode" in kinds),
            ("per_step", np.zeros((runs, channels))),
            ("per_episode", np.zeros((runs, channels))),
        ):
            object.__setattr__(self, name, value)

    def store(self, rewards: Float[np.ndarray, "B channels"]) -> Float[np.ndarray, "B channels"]:
        """Ends an episode whose rewards summed to `rewards`; what the learner sees of ρ, a fresh array."""
        if not self.any_by_episode:
            return self.per_step.copy()
        self.per_episode[...] += self.rate * (rewards - self.per_episode)
        return np.where(self.by_episode, self.per_episode, self.per_step)


def require_averages(average: str | Sequence[str]) -> None:
    """ValueError unless `average` is a kind or a sequence of kinds."""
    for kind in (average,) if isinstance(average, str) else average:
        if kind not in AVERAGES:
            raise ValueError(f"average should be one of {', '.join(AVERAGES)}, or one for each channel; found {kind!r}")
