"""Konda's actor-critic in a compiled environment: B runs advance one episode, each of its own length, in one call.

A critic enters a step through wᵀψ alone. With the value v = wᵀψ_t of the step before, a step needs one product for
each channel, wᵀψ_{t+1}, and one for all of them, zᵀψ_{t+1}:  v ← wᵀψ_{t+1} + α_w δ zᵀψ_{t+1} after w ← w + α_w δ z.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cpgrl_opt.arrays import Float
from envs.interface import ContinuousKernels

from ..kernels import kernel
from ..policies import NormalizedGaussianNetwork
from ..policies.normalized_gaussian_kernels import act, dot, exchange
from .continuous_rollout import ContinuousRollout, rollout_signature
from .interface import Estimate
from .reported_gradient import ReportedGradient
from .stored_average import StoredAverage

if TYPE_CHECKING:
    from .konda_actor_critic import KondaActorCritic


class ContinuousKonda:
    """B runs of `KondaActorCritic` on `ContinuousKernels`; carries ρ, w and the random states."""

    carried = ("rollout", "average", "reported", "exchanged_critics")

    def __init__(
        self,
        settings: "KondaActorCritic",
        kernels: ContinuousKernels,
        policy: NormalizedGaussianNetwork,
        streams: Sequence[np.random.SeedSequence],
    ) -> None:
        self.rollout = ContinuousRollout(advance, kernels, policy, settings.steps, streams)
        runs, channels, n = self.rollout.shape
        self.average = StoredAverage(settings, runs, channels)
        as_printed = settings.gradient == "episode mean"
        self.reported = ReportedGradient(self.average.by_episode, settings.average_rate, runs, as_printed=as_printed)
        self.centred = np.where(self.average.by_episode & (not as_printed), 0.0, 1.0)
        self.rates = (float(settings.trace_decay), float(settings.average_rate), float(settings.critic_rate))
        self.exchanged_critics = np.zeros((runs, channels, n))
        self.dimensions = policy.dimensions

    @property
    def critics(self) -> Float[np.ndarray, "B channels n"]:
        """w in θ's order, a fresh array."""
        runs, channels, _ = self.rollout.shape
        by_columns = self.exchanged_critics.reshape(runs, channels, self.dimensions, -1)
        return np.ascontiguousarray(by_columns.swapaxes(2, 3)).reshape(self.rollout.shape)

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """One episode of each run."""
        own = (*self.rates, self.centred, self.average.per_step, self.average.totals, self.exchanged_critics)
        means, rewards, steps, events = self.rollout.advance(parameters, own)
        gradients = self.reported.convert(means, steps, rewards)
        return Estimate(self.average.store(rewards), gradients, steps, rewards, events)


@kernel("float64(float64, float64[::1], float64[::1], float64[::1])", fastmath={"reassoc", "nsz", "contract"})
def _extend(decay, score, following, trace):  # type: ignore[no-untyped-def]
    """z ← βz + ψ_t; zᵀψ_{t+1}."""
    overlap = 0.0
    for j in range(trace.size):
        trace[j] = decay * trace[j] + score[j]
        overlap += trace[j] * following[j]
    return overlap


@kernel(
    "float64(float64, float64, float64, float64, float64[::1], float64[::1], float64[::1], float64[::1], float64[::1])"
)
def _criticize(surprise, rate, value, overlap, score, following, trace, critic, gradient):  # type: ignore[no-untyped-def]
    """Δ ← Δ + wᵀψ_t ψ_t, unnormalised, and w ← w + α_w δ z; the new value wᵀψ_{t+1}. surprise: r − ρ."""
    following_value = dot(critic, following)
    change = rate * (surprise + following_value - value)
    for j in range(critic.size):
        gradient[j] += value * score[j]
        critic[j] += change * trace[j]
    return following_value + change * overlap


@kernel(
    rollout_signature("float64, float64, float64, float64[::1], float64[:, ::1], float64[::1], float64[:, :, ::1]"),
)
def advance(  # type: ignore[no-untyped-def]
    reset,
    step,
    constants,
    limit,
    counts,
    places,
    falls,
    deviation,
    parameters,
    random_states,
    trace_decay,
    average_rate,
    critic_rate,
    centred,  # (1 + m,), 1 where the critic subtracts ρ, 0 where a sum over the episode is reported
    averages,  # (B, 1 + m), advanced
    totals,  # (B,), advanced: the weights in `averages`, whose quotient is ρ
    critics,  # (B, 1 + m, n), advanced, exchanged
    gradients,
    reward_sums,
    lengths,
    events,
):
    """One episode of B runs, one after the other."""
    runs, channels, n = critics.shape
    size = 1
    for count in counts:
        size *= count
    state, action, reward = np.empty(counts.size), np.empty(n // size), np.empty(channels)
    weights, features, values = np.empty(counts.max()), np.empty(size), np.empty(channels)
    theta, trace, scores, sums = np.empty(n), np.empty(n), np.empty((2, n)), np.empty((channels, n))
    nothing = np.zeros(n)
    for run in range(runs):
        random_state = random_states[run]
        exchange(parameters[run], size, theta)
        sums[:], trace[:], reward_sums[run] = 0.0, 0.0, 0.0
        reset(constants, random_state, state)
        act(theta, state, deviation, counts, places, falls, random_state, weights, features, action, scores[0])
        for i in range(channels):
            values[i] = dot(critics[run, i], scores[0])
        event = length = 0
        while event == 0 and length < limit:
            score, following = scores[length % 2], scores[1 - length % 2]
            event = step(constants, state, action, random_state, reward)
            length += 1
            if event == 0:  # at the time limit too, to bootstrap from
                act(theta, state, deviation, counts, places, falls, random_state, weights, features, action, following)
            else:
                following[:] = 0.0
            overlap = _extend(trace_decay, score, following, trace)
            totals[run] += average_rate * (1.0 - totals[run])
            ends = event != 0 or length == limit
            for i in range(channels):
                reward_sums[run, i] += reward[i]
                averages[run, i] += average_rate * (reward[i] - averages[run, i])
                values[i] = _criticize(
                    reward[i] - centred[i] * (averages[run, i] / totals[run]), critic_rate, values[i], overlap, score,
                    nothing if ends and centred[i] == 0.0 else following,  # a sum ends here
                    trace, critics[run, i], sums[i],
                )  # fmt: skip
        lengths[run], events[run] = length, event
        sums /= length
        for i in range(channels):
            exchange(sums[i], n // size, gradients[run, i])
