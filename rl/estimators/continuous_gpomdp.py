"""GPOMDP in a compiled environment: B runs advance one episode, each of its own length, in one call."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cpgrl_opt.arrays import Float
from envs.interface import ContinuousKernels

from ..kernels import kernel
from ..policies import NormalizedGaussianNetwork
from ..policies.normalized_gaussian_kernels import act, exchange
from .continuous_rollout import ContinuousRollout, rollout_signature
from .interface import Estimate
from .reported_gradient import ReportedGradient, UpdateWatch, channels_from_start, require_updates
from .stored_average import StoredAverage

if TYPE_CHECKING:
    from .gpomdp import GPOMDP


class ContinuousGPOMDP:
    """B runs of `GPOMDP` on `ContinuousKernels`; carries ρ and the random states."""

    carried = ("rollout", "average", "reported", "watch")

    def __init__(
        self,
        settings: "GPOMDP",
        kernels: ContinuousKernels,
        policy: NormalizedGaussianNetwork,
        streams: Sequence[np.random.SeedSequence],
    ) -> None:
        self.rollout = ContinuousRollout(advance, kernels, policy, settings.steps, streams)
        runs, channels, _ = self.rollout.shape
        self.average = StoredAverage(settings, runs, channels)
        self.reported = ReportedGradient(
            self.average.by_episode, settings.average_rate, runs, as_printed=settings.gradient == "episode mean"
        )
        by_episode = self.average.by_episode
        require_updates(settings.weights, settings.gradient, by_episode, min(int(settings.steps), kernels.max_steps))
        self.paper = settings.weights == "paper"
        self.rates = (float(settings.trace_decay), float(settings.average_rate))
        self.from_start = channels_from_start(settings.weights, settings.gradient, by_episode)
        self.watch = None if self.from_start.all() else UpdateWatch()

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """One episode of each run."""
        runs, channels, n = self.rollout.shape
        entered, spans = np.empty((runs, channels)), np.empty((runs, n))
        own = (
            self.paper,
            *self.rates,
            self.from_start,
            self.reported.subtracts,
            self.average.per_step,
            self.average.totals,
            entered,
            spans,
        )
        means, rewards, steps, events = self.rollout.advance(parameters, own)
        updates = steps - self.paper
        if self.watch is not None:
            self.watch.see(updates)
        gradients = self.reported.convert(means, updates, entered, spans if self.reported.subtracts else None)
        return Estimate(self.average.store(rewards), gradients, steps, rewards, events)


@kernel("void(float64[::1], float64, float64[::1])")
def _add(vector, factor, into):  # type: ignore[no-untyped-def]
    """into ← into + factor · vector."""
    for j in range(vector.size):
        into[j] += factor * vector[j]


@kernel("void(boolean, float64, float64[::1], float64[::1], float64[::1])")
def _meet(paper, decay, score, trace, met):  # type: ignore[no-untyped-def]
    """z ← βz + ψ, and what the reward meets: z + ψ with the z before ("paper"), or the z after."""
    for j in range(score.size):
        extended = decay * trace[j] + score[j]
        met[j] = trace[j] + score[j] if paper else extended
        trace[j] = extended


@kernel(
    rollout_signature(
        "boolean, float64, float64, boolean[::1], boolean, "
        "float64[:, ::1], float64[::1], float64[:, ::1], float64[:, ::1]"
    )
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
    paper,
    trace_decay,
    average_rate,
    from_start,  # (1 + m,), channels in whose Δ r(x₀, u₀) enters
    spanned,  # whether `spans` is wanted
    averages,  # (B, 1 + m), advanced
    totals,  # (B,), advanced: the weights in `averages`, whose quotient is ρ
    entered,  # (B, 1 + m), filled: Σ of the rewards in Δ
    spans,  # (B, n), filled: Σ of what they met
    gradients,
    reward_sums,
    lengths,
    events,
):
    """One episode of B runs, one after the other."""
    runs, channels, n = gradients.shape
    size = 1
    for count in counts:
        size *= count
    state, action, reward = np.empty(counts.size), np.empty(n // size), np.empty(channels)
    weights, features, score, met = np.empty(counts.max()), np.empty(size), np.empty(n), np.empty(n)
    theta, trace, sums, span = np.empty(n), np.empty(n), np.empty((channels, n)), np.zeros(n)
    for run in range(runs):
        random_state = random_states[run]
        exchange(parameters[run], size, theta)
        sums[:], trace[:], span[:], reward_sums[run], entered[run] = 0.0, 0.0, 0.0, 0.0, 0.0
        reset(constants, random_state, state)
        event = length = updates = 0
        while event == 0 and length < limit:
            act(theta, state, deviation, counts, places, falls, random_state, weights, features, action, score)
            event = step(constants, state, action, random_state, reward)
            _meet(paper, trace_decay, score, trace, met)
            enters = length > 0 or not paper  # as printed, r(x₀, u₀) enters neither Δ nor ρ
            length += 1
            updates += enters
            if enters:
                totals[run] += average_rate * (1.0 - totals[run])
            if spanned and enters:
                _add(met, 1.0, span)
            for i in range(channels):
                reward_sums[run, i] += reward[i]
                if enters:
                    averages[run, i] += average_rate * (reward[i] - averages[run, i])
                if enters or from_start[i]:
                    entered[run, i] += reward[i]
                    if reward[i] != 0.0:
                        _add(met, reward[i], sums[i])
        lengths[run], events[run] = length, event
        sums /= max(updates, 1)
        for i in range(channels):
            exchange(sums[i], n // size, gradients[run, i])
        exchange(span, n // size, spans[run])
