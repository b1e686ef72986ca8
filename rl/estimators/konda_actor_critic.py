"""Konda's actor-critic: policy gradients of all reward channels from one critic for each.

A critic enters a step through wᵀψ alone. With the value v = wᵀψ_t of the step before, a step needs one product for
each channel, wᵀψ_{t+1}, and one for all of them, zᵀψ_{t+1}:  v ← wᵀψ_{t+1} + α_w δ zᵀψ_{t+1} after w ← w + α_w δ z.
"""

from dataclasses import dataclass

import numpy as np

from cpgrl_opt.validation import require_positive, require_within

from .._late_kernels import inner, late_kernel
from ..drivers import Rule, compiled_step
from .reported_gradient import ReportedGradient
from .sampling import SamplingEstimator


@dataclass(frozen=True, kw_only=True)
class KondaActorCritic(SamplingEstimator):
    """Qⁱ(x, u) = wⁱᵀψ(x, u),   Δⁱ ← mean of Qⁱ(x_t, u_t) ψ_t,   at every step, in this order:

        Δⁱ ← Δⁱ + (wⁱᵀψ_t ψ_t − Δⁱ)/(t + 1)            eq. 5
        z ← βz + ψ_t
        ρⁱ ← ρⁱ + α_r (rⁱ_t − ρⁱ)                      eq. 4
        δⁱ = rⁱ_t − ρⁱ + wⁱᵀ(ψ_{t+1} − ψ_t)
        wⁱ ← wⁱ + α_w δⁱ z

    rⁱ_t is what (x_t, u_t) yields. The paper prints r_{t+1}, with which Q(x_t, u_t) would lose its own reward; its
    limit is then off the exact gradient by more than half, against 0.003–0.011 (docs/reproduction.md, slip 9).
    z and Δ restart with each episode; w and ρ go on (§2.4 as we read it; resetting w kills learning). ψ_{t+1} = 0
    after an event that ends the episode; at the time limit one more action is drawn to bootstrap from.

    Δ is the gradient of the ρ that `average` reports, also where episodes differ in length. Given the past of step t,
    E[ψ_t] = 0, so E[z ψ_{t+1}ᵀ] = 0, E[z ψ_tᵀ] = E[ψ_t ψ_tᵀ], and where w settles (sums over an episode of T steps)

        E[Σ_t ψ_t ψ_tᵀ] wⁱ = E[Σ_t (rⁱ_t − ρⁱ) z]  →  ∇E[Σ_t rⁱ_t] − ρⁱ ∇E[T]    as β → 1

    "step"     reports E[Σ rⁱ]/E[T]: Δⁱ = Σ_t Qⁱψ_t / (mean number of steps), eq. 5 where episodes are equally long
    "episode"  reports E[Σ rⁱ]: this channel's critic subtracts no ρ, its sum ends at the time limit (ψ_{t+1} = 0), and
               Δⁱ = Σ_t Qⁱψ_t
    gradient "episode mean" is eq. 5 as printed: ρ per step subtracted in every critic, and the mean over each episode's
    own steps, whatever `average` says. `ReportedGradient` says which mean number of steps it is.

    α_w ‖ψ‖² well below 1 keeps w bounded: with a Gaussian policy, whose ψ grows as 1/σ, σ ~ 1 in the unit of u.
    As the critic settles, w tends to the fixed point of TD(β) and Δ to E[ψψᵀ]w, as β → 1 to the exact gradient.
    That holds for small rates. At the paper's, α_r/(1 − β) = 2: ρ follows rewards as fast as z forgets, and on the
    three-state MDP the mean of Δ points the same way (cosine > 0.99) but is half as long.

    Parameters
    ----------
    trace_decay
        β, in [0, 1).
    critic_rate
        α_w > 0; the paper's is α_r.
    average_rate, average, steps, gradient, bias_correction
        See `SamplingEstimator`. The ρ per step that critics subtract is corrected as the reported one is.

    Notes
    -----
    Source: eq. 5 of the paper and the equations after it; Konda & Tsitsiklis (2003).
    """

    trace_decay: float = 0.99
    critic_rate: float = 0.02
    steps: int = 1000

    def __post_init__(self) -> None:
        require_within("trace_decay", self.trace_decay, "[0, 1)")
        require_positive("critic_rate", self.critic_rate)  # at 0 critics, and Δ, would stay 0
        super().__post_init__()

    def rule(self, reported: ReportedGradient) -> Rule:
        """Carries w, a row for each channel; z is of θ's length, v one number for each channel."""
        centred = np.where(reported.summed, 0.0, 1.0)  # where the critic subtracts ρ
        return Rule(
            advance,
            constants=(self.trace_decay, self.critic_rate),
            channels=np.array([centred, np.zeros_like(centred)]),
            vectors=1,
            memory=len(centred),
            looks_ahead=True,
        )


@compiled_step
def advance(course, t, score, reward, following, last):  # type: ignore[no-untyped-def]
    """All of the above at once. Where a sum is reported, no ρ is subtracted, and it ends with the last step."""
    trace, centred, value = course.vectors[0], course.channels[0], course.channels[1]
    place, values = score.place, score.values
    if t == 0:
        for i in range(reward.size):
            value[i] = inner(course.memory[i], place, values)
    extend(course.constants[0], place, values, trace)
    overlap = inner(trace, following.place, following.values)
    for i in range(reward.size):
        critic, gradient = course.memory[i], course.gradients[i, place : place + values.size]
        later, ahead = inner(critic, following.place, following.values), overlap
        if last and centred[i] == 0.0:
            later = ahead = 0.0
        change = course.constants[1] * (reward[i] - centred[i] * course.average[i] + later - value[i])
        for j in range(values.size):
            gradient[j] += value[i] * values[j]
        for j in range(trace.size):
            critic[j] += change * trace[j]
        value[i] = later + change * ahead


@late_kernel("void(float64, int64, float64[::1], float64[::1])", fastmath={"reassoc", "nsz", "contract"})
def extend(decay, place, values, trace):  # type: ignore[no-untyped-def]
    """z ← βz + ψ."""
    for j in range(place):
        trace[j] *= decay
    window, rest = trace[place : place + values.size], trace[place + values.size :]
    for j in range(values.size):
        window[j] = decay * window[j] + values[j]
    for j in range(rest.size):
        rest[j] *= decay
