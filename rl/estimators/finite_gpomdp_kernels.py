"""Kernels of `finite_gpomdp`: an episode of B runs.

Swapping the sums of eq. 3 gives each score the rewards that follow it, so no trace of length n is carried:

    Σ_t rⁱ_t (z_t + ψ_t) = Σ_t ψ_t (rⁱ_t + c Lⁱ_t),   Lⁱ_t = rⁱ_{t+1} + β Lⁱ_{t+1},   c = 1 ("paper") or β ("usual")

An episode is simulated forward, runs in the inner loop to fill the processor's pipelines, then walked backward
gathering G[q] = Σ (rⁱ_t + c Lⁱ_t) for each pair q = (state, action); the scores enter once, by Σ_q ψ(q) G[q]. A step
costs the same for any number of states and actions up to their search, and hardly more for four channels than for one.
"""

import numpy as np

from envs.interface.random_stream import next_word

from .._kernels import helper
from .._late_kernels import late_kernel
from ..drivers.finite import pick, tabulate

LANES = 4  # channels handled together, one vector register of float64


@helper
def _simulate(actions, transitions, start, random_states, visits):  # type: ignore[no-untyped-def]
    """One word a step: its high half draws the action, its low half the next state; visits (T, B) are s·A + a."""
    steps, runs = visits.shape
    choices = np.uint64(actions.shape[2])
    state = np.full(runs, np.uint64(start))
    for t in range(steps):
        for run in range(runs):
            word = next_word(random_states[run])
            s = state[run]
            a = pick(actions[run, s], word >> np.uint64(32))
            visits[t, run] = s * choices + a
            state[run] = pick(transitions[s, a], word & np.uint64(0xFFFFFFFF))


@helper
def _gather(visits, run, rewards, first, from_start, decay, following, rate, gathered, sums):  # type: ignore[no-untyped-def]
    """G[q] = Σ (r_t + c L_t) over visits to q, sums[0] = Σ r_t, sums[1] = Σ α_r (1 − α_r)^{T−1−t} r_t; four lanes."""
    steps = visits.shape[0]
    for i in range(0, rewards.shape[1], LANES):
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
        for lane in range(LANES):
            sums[0, i + lane], sums[1, i + lane] = total[lane], recent[lane]
            if first == 1:  # r(x₀, u₀) enters neither ρ per step nor its Δ, only the episode's sum and that one's
                gathered[visits[0, run], i + lane] += following * later[lane]
                sums[0, i + lane] += rewards[visits[0, run], i + lane]
                if i + lane < from_start.size and from_start[i + lane]:
                    gathered[visits[0, run], i + lane] += rewards[visits[0, run], i + lane]


@helper
def contract(gathered, probabilities, divisors, gradients):  # type: ignore[no-untyped-def]
    """Δⁱ = Σ_q ψ(q) Gⁱ[q] / divisors[i]: G − μ(s, ·) Σ_b G[s, b] in each state."""
    states, actions = probabilities.shape
    for i in range(gradients.shape[0]):
        for s in range(states):
            total = 0.0
            for a in range(actions):
                total += gathered[s * actions + a, i]
            for a in range(actions):
                q = s * actions + a
                gradients[i, q] = (gathered[q, i] - probabilities[s, a] * total) / divisors[i]


@late_kernel(
    "void(float64[:, ::1], uint64[:, :, ::1], float64[:, ::1], int64, int64, int64, boolean[::1], float64[::1], "
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
    thresholds = np.empty((runs, states, actions), np.uint64)
    visits = np.empty((steps, runs), np.uint32)
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
