"""GPOMDP: policy gradients of all reward channels from one trace."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np

from cpgrl_opt.validation import require_member, require_within

from .._late_kernels import late_kernel
from ..drivers import Driver, Rule, compiled_step
from .interface import Estimation
from .reported_gradient import ReportedGradient
from .sampling import SamplingEstimator

if TYPE_CHECKING:
    from ..drivers.finite import FiniteDriver

WEIGHTS = ("paper", "usual")


@dataclass(frozen=True, kw_only=True)
class GPOMDP(SamplingEstimator):
    """z ← βz + ψ,  Δⁱ ← mean of rⁱ(z + ψ),  ρⁱ ← ρⁱ + α_r (rⁱ − ρⁱ): one trace for all channels.

    With weights "paper", eq. 3 as printed: rⁱ(x_t, u_t) meets z_t + ψ_t, z_t = Σ_{k<t} βᵗ⁻¹⁻ᵏ ψ_k, so a score is
    weighted 1, 1, β, β², … with the rewards from its own step on; r(x₀, u₀) enters neither Δ nor ρ, and an episode of
    T steps makes T − 1 updates. With "usual", rⁱ(x_t, u_t) meets z_{t+1}: weights 1, β, β², …, T updates.
    z and Δ restart with each episode; ρ goes on from the last one's (our reading of §2.4, which breaks off).

    Δ is the gradient of the ρ that `average` reports, also where episodes differ in length (`ReportedGradient` derives
    it): with "episode" the sum Σ_t rⁱ(z + ψ), with "step" Σ_t (rⁱ − ρⁱ)(z + ψ) over the mean number of updates, which
    is eq. 3's mean where all episodes are equally long. With weights "paper" the report per step leaves the first step
    out too: it is E[Σ_{t≥1} rⁱ]/E[T − 1]. The report per episode is the whole sum, so there r(x₀, u₀) meets ψ₀ in Δ.
    gradient "episode mean" is eq. 3 as printed, the mean over each episode's own updates whatever `average` says.

    Parameters
    ----------
    trace_decay
        β, in [0, 1).
    weights
        "paper" or "usual".
    average_rate, average, steps, gradient, bias_correction
        See `SamplingEstimator`.

    Notes
    -----
    Bias, the price of β < 1: ‖limit for T → ∞ − ∇gⁱ‖ / ‖∇gⁱ‖ is at most 0.014, 0.0014, 0.00014 at β = 0.9, 0.99, 0.999
    over the channels of the three-state MDP and 1000 policies θ ~ U[0, 1]⁹; with "usual" 0.064, 0.0065, 0.00065.
    A finite MDP with a `SoftmaxTable` keeps 4 bytes of each step (`finite_gpomdp`). Everything else: `rl.drivers`.
    Source: eq. 3 and 4 of the paper; Baxter & Bartlett (2001).
    """

    trace_decay: float = 0.99
    weights: str = "paper"

    def __post_init__(self) -> None:
        require_within("trace_decay", self.trace_decay, "[0, 1)")
        require_member("weights", self.weights, tuple(WEIGHTS))
        super().__post_init__()

    def rule(self, reported: ReportedGradient) -> Rule:
        """The trace z and Σ_t of what the rewards meet, of θ's length; z is one for all channels."""
        paper = self.weights == "paper"
        from_start = reported.summed | (not paper)
        return Rule(
            advance,
            constants=(self.trace_decay, paper, reported.subtracts),
            channels=np.where(from_start, 1.0, 0.0)[None],
            vectors=3,
            first=int(paper),
            from_start=from_start,
            span=2 if reported.subtracts else None,
        )

    def with_driver(self, driver: Driver) -> Estimation:
        """On a finite MDP without a trace: scores meet the rewards that follow them, all runs at once."""
        if not hasattr(driver, "mdp") or type(self).rule is not GPOMDP.rule:  # a subclass's own rule goes step by step
            return super().with_driver(driver)
        from .finite_gpomdp import FiniteGPOMDP  # numba loads here

        return FiniteGPOMDP(self, cast("FiniteDriver", driver))


@compiled_step
def advance(course, t, score, reward, following, last):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Δⁱ ← Δⁱ + rⁱ(z + ψ), unnormalised; as printed r(x₀, u₀) enters nothing."""
    paper, spanned = course.constants[1] != 0.0, course.constants[2] != 0.0
    met = course.vectors[1]
    meet(paper, course.constants[0], score.place, score.values, course.vectors[0], met)
    enters = t > 0 or not paper
    if enters and spanned:
        add(1.0, met, course.vectors[2])
    for i in range(reward.size):
        if (enters or course.channels[0, i] != 0.0) and reward[i] != 0.0:
            add(reward[i], met, course.gradients[i])


@late_kernel("void(boolean, float64, int64, float64[::1], float64[::1], float64[::1])")
def meet(paper, decay, place, values, trace, met):  # type: ignore[no-untyped-def]
    """z ← βz + ψ, and what the reward meets: z + ψ with the z before ("paper"), or the z after."""
    dense = values.size == trace.size  # one pass then, where time counts
    for j in range(trace.size):
        own = values[j] if dense else 0.0
        later = decay * trace[j] + own
        met[j] = trace[j] + own if paper else later
        trace[j] = later
    if not dense:
        add(1.0, values, trace[place : place + values.size])
        add(1.0, values, met[place : place + values.size])


@late_kernel("void(float64, float64[::1], float64[::1])")
def add(factor, vector, into):  # type: ignore[no-untyped-def]
    """into ← into + factor · vector."""
    for j in range(vector.size):
        into[j] += factor * vector[j]
