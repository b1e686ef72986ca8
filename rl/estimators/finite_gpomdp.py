"""GPOMDP on a finite MDP with a softmax table, compiled: B runs advance one episode in one call.

Swapping the sums of eq. 3 gives each score the rewards that follow it, so no trace of length n is carried:

    Σ_t rⁱ_t (z_t + ψ_t) = Σ_t ψ_t (rⁱ_t + c Lⁱ_t),   Lⁱ_t = rⁱ_{t+1} + β Lⁱ_{t+1},   c = 1 ("paper") or β ("usual")

An episode is simulated forward, runs in the inner loop to fill the processor's pipelines, then walked backward
gathering G[q] = Σ (rⁱ_t + c Lⁱ_t) for each pair q = (state, action); the scores enter once, by Σ_q ψ(q) G[q]. A step
costs the same for any number of states and actions up to their search, and hardly more for four channels than for one.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from envs.interface import FiniteKernel, random_state
from envs.interface.random_stream import next_word

from ..kernels import kernel
from ..policies import SoftmaxTable
from .finite_rollout import contract, drawn, tabulate, transition_thresholds
from .interface import Estimate
from .reported_gradient import channels_from_start, require_updates
from .stored_average import StoredAverage, sum_of_weights

if TYPE_CHECKING:
    from .gpomdp import GPOMDP

_LANES = 4  # channels handled together, one vector register of float64


class FiniteGPOMDP:
    """B runs of GPOMDP on a `FiniteKernel`; carries ρ and the random states.

    A draw is 32 bits: events rarer than 2⁻³² per step do not occur.
    Raises ValueError when the policy's table does not fit the kernel.
    """

    def __init__(
        self,
        settings: "GPOMDP",
        mdp: FiniteKernel,
        policy: SoftmaxTable,
        streams: Sequence[np.random.SeedSequence],
    ) -> None:
        channels, states, actions = mdp.rewards.shape
        self.transitions = transition_thresholds(mdp, policy)
        lanes = -(-channels // _LANES) * _LANES
        self.rewards = np.zeros((states * actions, lanes))
        self.rewards[:, :channels] = mdp.rewards.reshape(channels, -1).T
        self.start = mdp.start
        self.steps = int(settings.steps)
        paper = settings.weights == "paper"
        self.first = 1 if paper else 0  # step of the first reward that enters
        self.following = 1.0 if paper else settings.trace_decay  # c
        self.trace_decay, self.average_rate = float(settings.trace_decay), float(settings.average_rate)
        self.random_states = np.array([random_state(stream) for stream in streams])
        self.average = StoredAverage(settings, len(streams), channels)
        require_updates(settings.weights, settings.gradient, self.average.by_episode, self.steps)
        # Episodes are equally long: for a report per step the mean over the updates is right, see `ReportedGradient`.
        summed = self.average.by_episode & (settings.gradient == "reported")
        self.divisors = np.where(summed, 1.0, max(self.steps - self.first, 1))
        self.from_start = channels_from_start(settings.weights, settings.gradient, self.average.by_episode)
        self.gain = sum_of_weights(self.average_rate, self.steps - self.first)
        self.shape = (len(streams), channels, states * actions)
        self.taken, self.events = np.full(len(streams), self.steps), np.zeros(len(streams), dtype=np.int64)

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """One episode of each run in one compiled call."""
        gradients = np.empty(self.shape)
        rewards = np.empty(self.shape[:2])
        advance(
            np.ascontiguousarray(parameters),
            self.transitions,
            self.rewards,
            self.start,
            self.steps,
            self.first,
            self.from_start,
            self.divisors,
            self.trace_decay,
            self.following,
            self.average_rate,
            self.random_states,
            self.average.per_step,
            gradients,
            rewards,
        )
        if not self.average.settled:
            self.average.totals[:] += self.gain * (1.0 - self.average.totals)
        return Estimate(self.average.store(rewards), gradients, self.taken.copy(), rewards, self.events.copy())


@kernel("void(int64[:, :, ::1], int64[:, :, ::1], int64, uint64[:, ::1], int32[:, ::1])")
def _simulate(actions, transitions, start, random_states, visits):  # type: ignore[no-untyped-def]
    """One word a step: its high half draws the action, its low half the next state; visits (T, B) are s·A + a."""
    steps, runs = visits.shape
    state = np.full(runs, start)
    for t in range(steps):
        for run in range(runs):
            word = next_word(random_states[run])
            s = state[run]
            a = drawn(actions[run, s], np.int64(word >> np.uint64(32)))
            visits[t, run] = s * actions.shape[2] + a
            state[run] = drawn(transitions[s, a], np.int64(word & np.uint64(0xFFFFFFFF)))


@kernel(
    "void(int32[:, ::1], int64, float64[:, ::1], int64, boolean[::1], float64, float64, float64, float64[:, ::1], "
    "float64[:, ::1])"
)
def _gather(visits, run, rewards, first, from_start, decay, following, rate, gathered, sums):  # type: ignore[no-untyped-def]
    """G[q] = Σ (r_t + c L_t) over visits to q, sums[0] = Σ r_t, sums[1] = Σ α_r (1 − α_r)^{T−1−t} r_t; four lanes."""
    steps = visits.shape[0]
    for i in range(0, rewards.shape[1], _LANES):
        L0 = L1 = L2 = L3 = 0.0
        S0 = S1 = S2 = S3 = 0.0
        M0 = M1 = M2 = M3 = 0.0
        weight = rate
        for t in range(steps - 1, first - 1, -1):
            q = visits[t, run]
            r0, r1, r2, r3 = rewards[q, i], rewards[q, i + 1], rewards[q, i + 2], rewards[q, i + 3]
            gathered[q, i] += r0 + following * L0
            gathered[q, i + 1] += r1 + following * L1
            gathered[q, i + 2] += r2 + following * L2
            gathered[q, i + 3] += r3 + following * L3
            L0, L1, L2, L3 = r0 + decay * L0, r1 + decay * L1, r2 + decay * L2, r3 + decay * L3
            S0, S1, S2, S3 = S0 + r0, S1 + r1, S2 + r2, S3 + r3
            M0, M1, M2, M3 = M0 + weight * r0, M1 + weight * r1, M2 + weight * r2, M3 + weight * r3
            weight *= 1.0 - rate
        later, total, recent = (L0, L1, L2, L3), (S0, S1, S2, S3), (M0, M1, M2, M3)
        for lane in range(_LANES):
            sums[0, i + lane], sums[1, i + lane] = total[lane], recent[lane]
            if first == 1:  # r(x₀, u₀) enters neither ρ per step nor its Δ, only the episode's sum and that one's
                gathered[visits[0, run], i + lane] += following * later[lane]
                sums[0, i + lane] += rewards[visits[0, run], i + lane]
                if i + lane < from_start.size and from_start[i + lane]:
                    gathered[visits[0, run], i + lane] += rewards[visits[0, run], i + lane]


@kernel(
    "void(float64[:, ::1], int64[:, :, ::1], float64[:, ::1], int64, int64, int64, boolean[::1], float64[::1], "
    "float64, float64, float64, uint64[:, ::1], float64[:, ::1], float64[:, :, ::1], float64[:, ::1])"
)
def advance(  # type: ignore[no-untyped-def]
    parameters,  # (B, S·A)
    transitions,  # (S, A, S) least draws beyond each next state
    rewards,  # (S·A, lanes), channels padded with zeros
    start,
    steps,
    first,
    from_start,  # (1 + m,), channels in whose Δ r(x₀, u₀) enters
    divisors,  # (1 + m,), of Δ
    trace_decay,
    following,
    average_rate,
    random_states,  # (B, 4), advanced
    averages,  # (B, 1 + m), advanced
    gradients,  # (B, 1 + m, S·A), filled
    reward_sums,  # (B, 1 + m), filled
):
    """One episode of B runs."""
    runs, pairs = parameters.shape
    states, actions = transitions.shape[:2]
    probabilities = np.empty((runs, states, actions))
    thresholds = np.empty((runs, states, actions), np.int64)
    visits = np.empty((steps, runs), np.int32)
    gathered, sums = np.empty((pairs, rewards.shape[1])), np.empty((2, rewards.shape[1]))
    for run in range(runs):
        tabulate(parameters[run], probabilities[run], thresholds[run])
    _simulate(thresholds, transitions, start, random_states, visits)
    updates = steps - first
    kept = (1.0 - average_rate) ** updates
    for run in range(runs):
        gathered[:] = 0.0
        _gather(visits, run, rewards, first, from_start, trace_decay, following, average_rate, gathered, sums)
        contract(gathered, probabilities[run], divisors, gradients[run])
        for i in range(averages.shape[1]):
            averages[run, i] = kept * averages[run, i] + sums[1, i]
            reward_sums[run, i] = sums[0, i]
