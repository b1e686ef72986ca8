"""Average rewards that outlive an episode (§2.4)."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cpgrl_opt.arrays import Float
from cpgrl_opt.validation import require_within

AVERAGES = ("step", "episode")
_SETTLED = 1 - 1e-14  # a sum of weights that counts as 1: at α = 0.02 it stalls 3e-15 below


class MeanWeight:
    """γ_k = α / (1 − (1 − α)ᵏ) of the k-th number in the mean M ← M + γ_k (x_k − M), which is Σ_j (1 − α)^{k−j} x_j
    divided by the sum of its weights.

    M is x_1 after the first number, the plain mean as long as k ≪ 1/α, and remembers about 1/α numbers later on; with
    α = 0 it stays the plain mean. M is exactly x where all numbers are x, as γ_1 is exactly 1.
    """

    carried = ("count", "total")

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self.count = 0
        self.total = 0.0  # 1 − (1 − α)ᵏ, by the same recursion: a difference of powers would lose digits at small α

    def next(self) -> float:
        """γ_k for the next k, from 1 on."""
        self.count += 1
        self.total += self.rate * (1.0 - self.total)
        return self.rate / self.total if self.rate > 0 else 1.0 / self.count


class StoredAverage:
    """ρⁱ of B runs: stored at the end of an episode, the starting value in the next.

        "step"      ρⁱ ← ρⁱ + α_r (rⁱ_t − ρⁱ)    at every step (eq. 4), in reward per step
        "episode"   ρⁱ ← ρⁱ + α_r (Σ_t rⁱ_t − ρⁱ)    at the end of every episode, in reward per episode

    From 0, eq. 4 alone is Σ_k α_r (1 − α_r)^{t−k} r_k after t numbers: its weights add up to W = 1 − (1 − α_r)ᵗ only,
    so that 34 episodes of −100 at α_r = 0.02 are taken for −50. With `bias_correction` the report is divided by W and
    is a mean from the first number on; without, it is eq. 4 as printed.

    Our reading: §2.4, on backups of the averages, breaks off in our copy, and "episode" is ours alone. A channel's
    kind decides which average it shows to the learner, and so the unit of its threshold. Eq. 4 is kept for every
    channel all the same, since critics subtract it.

    Parameters
    ----------
    settings
        An estimator's `average`, a kind for all channels or one for each, `average_rate` and `bias_correction`.
    runs, channels
        B and 1 + m.

    Notes
    -----
    per_step: (B, 1 + m), eq. 4 as printed, and totals: (B,), its W (1 without correction), which the estimator
    advances in place, both at the same steps; per_episode: (B, 1 + m), as reported.

    Raises
    ------
    ValueError
        For other kinds, or not as many as channels.
    """

    carried = ("per_step", "totals", "per_episode", "weight", "settled")

    def __init__(self, settings: Any, runs: int, channels: int) -> None:
        average = settings.average
        kinds_of_average(average)
        kinds = (average,) * channels if isinstance(average, str) else tuple(average)
        if len(kinds) != channels:
            raise ValueError(f"average should be one kind, or {channels}, one for each channel; found {len(kinds)}")
        self.rate = float(settings.average_rate)
        self.corrects = bool(settings.bias_correction)
        self.by_episode = np.array([kind == "episode" for kind in kinds])
        self.any_by_episode = "episode" in kinds
        self.per_step = np.zeros((runs, channels))
        self.totals = np.full(runs, 0.0 if self.corrects else 1.0)
        self.per_episode = np.zeros((runs, channels))
        self.weight = MeanWeight(self.rate)
        self.settled = not self.corrects

    def store(self, rewards: Float[np.ndarray, "B channels"]) -> Float[np.ndarray, "B channels"]:
        """Ends an episode whose rewards summed to `rewards`; what the learner sees of ρ, a fresh array.

        0 where a run has made no step that enters eq. 4.
        """
        per_step = self.per_step.copy()
        if not self.settled:
            near, none = self.totals > _SETTLED, self.totals == 0
            per_step /= np.where(near | none, 1.0, self.totals)[:, None]
            self.settled = bool(near.all())  # it only grows: dividing costs as much as a fifth of the episode
        if not self.any_by_episode:
            return per_step
        weight = self.weight.next() if self.corrects else self.rate
        self.per_episode[...] += weight * (rewards - self.per_episode)
        return np.where(self.by_episode, self.per_episode, per_step)


def sum_of_weights(rate: float, count: int) -> float:
    """1 − (1 − α)ᵏ, to all digits at small α."""
    if count == 0 or rate == 1:
        return float(count > 0)
    return float(-np.expm1(count * np.log1p(-rate)))


def kinds_of_average(average: str | Sequence[str]) -> str | tuple[str, ...]:
    """The kind, or the kinds of all channels; ValueError for anything else."""
    is_several = isinstance(average, Sequence | np.ndarray) and not isinstance(average, str)
    kinds: tuple[Any, ...] = tuple(average) if is_several else (average,)
    for kind in kinds:
        if not isinstance(kind, str) or kind not in AVERAGES:
            raise ValueError(f"average should be one of {', '.join(AVERAGES)}, or one for each channel; found {kind!r}")
    return average if isinstance(average, str) else kinds


def require_average_settings(settings: Any) -> None:
    """ValueError for a rate, a kind or a correction that is none."""
    rate = settings.average_rate
    require_within("average_rate", rate, "[0, 1]")
    if not isinstance(settings.bias_correction, (bool, np.bool_)):
        raise ValueError(f"bias_correction should be True or False; found {settings.bias_correction!r}")
    if rate == 0 and settings.bias_correction:
        raise ValueError(
            "average_rate should be above 0, since ρ would never leave 0; found 0. With bias_correction=False it is "
            "taken, for a ρ that stays 0"
        )
    kinds_of_average(settings.average)
