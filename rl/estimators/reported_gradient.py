"""From an episode's mean of the gradient estimate to the gradient of the ρ that is reported."""

import warnings

import numpy as np

from cpgrl_opt.arrays import Bool, Float, Int
from cpgrl_opt.validation import require_member

from .stored_average import MeanWeight

GRADIENTS = ("reported", "episode mean")
# Episodes without an update after which there is a warning, and after which learning is taken for impossible. Where one
# of ten has one step only, five of them follow each other with a chance of 1e-5; where one of two, twenty with 1e-6.
_MANY, _ENOUGH = 5, 20
_ADVICE = 'weights="paper" makes T − 1 updates of an episode of T steps, so ρ and Δ would stay 0. Use weights="usual"'


class ReportedGradient:
    """∇ρⁱ for the ρⁱ that `average` reports, of B runs whose episodes may differ in length.

    An episode makes N updates: its T steps, or T − 1 with the weights "paper", where the first one does not enter.
    R = Σ_t r_t over them, and m_t = Σ_{k≤t} ψ_k, the trace that r_t meets as β → 1. Whether an episode goes on to step
    t is decided before u_t is drawn, so E[ψ_k] = 0 given the past of step k, and ∇ log Pr(x₀, u₀ … x_t, u_t) = m_t:

        ∇E[R] = E[Σ_t r_t m_t],    ∇E[N] = E[Σ_t m_t]    (a reward of 1 at every step)

        "episode"  reports E[R]:           Δ = Σ_t r_t m_t
        "step"     reports ρ = E[R]/E[N]:  Δ = Σ_t (r_t − ρ) m_t / N̄,  as  ∇ρ = (∇E[R] − ρ ∇E[N]) / E[N]

    The second report is eq. 4 run on over the episodes, which renewal–reward takes to E[R]/E[N]. N̄ and ρ = R̄/N̄ are
    means over the run's *earlier* episodes, weighted by `MeanWeight`, so they are independent of this one's scores:
    E[Σ_t (r_t − ρ) m_t] = ∇E[R] − E[ρ] ∇E[N], and N̄ is one positive factor for all channels. Eq. 4 itself would not
    do for ρ: read where an episode ends it gives a last reward more weight than a first one. N̄ counts as at least
    γN, what N alone adds to the next mean, so that one long episode after short ones moves θ no further.

    As long as a run's episodes are equally long, N̄ = N and ∇E[N] is 0: there ρ is not subtracted, and Δ is the mean
    over the episode, bit for bit eq. 3 or 5. Where they differ it is the estimate with the least noise of those tried:
    with terminal states and E[N] = 10 to 100, β = 0.99 and 0.999, a baseline that vanishes at N = N̄ exactly, as
    ρ (N − N̄) Σ_t ψ_t or its discounted form, has a standard deviation of 1.2 to 16 times this one's.

    The mean over the episode's own N updates, "episode mean", is what the paper prints in eq. 3 and 5. Its expectation
    is about ∇E[R/N], which is neither report's gradient unless all episodes are equally long.
    """

    carried = ("weight", "lengths", "rewards", "unequal")

    def __init__(self, by_episode: Bool[np.ndarray, "channels"], rate: float, runs: int, *, as_printed: bool) -> None:
        self.by_episode = by_episode
        self.as_printed = as_printed
        self.weight = MeanWeight(rate)
        self.lengths = np.zeros(runs)  # N̄
        self.rewards = np.zeros((runs, len(by_episode)))  # R̄
        self.unequal = np.zeros(runs, dtype=np.bool_)  # runs that have seen episodes of two lengths

    @property
    def summed(self) -> Bool[np.ndarray, "channels"]:
        """Channels whose Δ is of the sum over an episode."""
        return self.by_episode & (not self.as_printed)

    @property
    def subtracts(self) -> bool:
        """Whether Σ_t m_t may be asked for."""
        return not self.as_printed and not bool(self.by_episode.all())

    @np.errstate(over="ignore", invalid="ignore")  # what overflows shows in the estimate
    def convert(
        self,
        means: Float[np.ndarray, "B channels n"],
        updates: Int[np.ndarray, "B"],
        rewards: Float[np.ndarray, "B channels"],
        spans: Float[np.ndarray, "B n"] | None = None,
    ) -> Float[np.ndarray, "B channels n"]:
        """Δ of an episode from its mean over the own N updates; what is carried goes one episode on.

        rewards: R over the same updates; spans: Σ_t m_t, None where ρ has been subtracted before (critics do).
        """
        if self.as_printed:
            return means
        own, earlier = np.asarray(updates, dtype=np.float64), self.lengths
        if self.weight.count:
            self.unequal |= own != earlier
        weight = self.weight.next()
        divisors = np.where(self.unequal, np.maximum(earlier, weight * own), own)
        divisors[divisors == 0] = 1.0  # no update yet: Δ is 0
        factors = np.where(self.by_episode, np.maximum(own, 1.0)[:, None], (own / divisors)[:, None])
        gradients: Float[np.ndarray, "B channels n"] = means * factors[:, :, None]
        if spans is not None and self.unequal.any():
            averages = self.rewards / np.where(earlier > 0, earlier, 1.0)[:, None]
            subtracted = np.where(self.by_episode | ~self.unequal[:, None], 0.0, averages / divisors[:, None])
            gradients -= subtracted[:, :, None] * spans[:, None, :]
        self.lengths = earlier + weight * (own - earlier)
        self.rewards += weight * (rewards - self.rewards)
        return gradients


class UpdateWatch:
    """Warns after _MANY episodes without an update, counted over all runs; ValueError after _ENOUGH.

    Once a run has made an update it says nothing more: a one-step episode among longer ones rightly adds nothing to Δ.
    """

    carried = ("episodes", "updated")

    def __init__(self) -> None:
        self.episodes = 0
        self.updated = False

    def see(self, updates: Int[np.ndarray, "B"]) -> None:
        """The numbers of updates of an episode of each run."""
        if self.updated:
            return
        self.updated = bool((updates > 0).any())
        self.episodes += len(updates)
        if self.updated:
            return
        told = (
            f"episodes should have more than one step; found one step in each of the first {self.episodes}. {_ADVICE}"
        )
        if self.episodes >= _ENOUGH:
            raise ValueError(told)
        if self.episodes >= _MANY:
            warnings.warn(told, stacklevel=2)


def require_updates(first: int, from_start: Bool[np.ndarray, "channels"], steps: int) -> None:
    """ValueError where episodes of `steps` steps at most never make an update of a channel."""
    if steps <= first and not from_start.all():
        raise ValueError(f"steps should be above {first}; found {steps}. {_ADVICE}")


def require_gradient(gradient: str) -> None:
    """ValueError unless `gradient` is one of GRADIENTS."""
    require_member("gradient", gradient, tuple(GRADIENTS))
