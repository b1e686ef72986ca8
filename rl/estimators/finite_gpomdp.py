"""GPOMDP on a finite MDP with a softmax table, compiled: B runs advance one episode in one call.

Swapping the sums of eq. 3 gives each score the rewards that follow it, so no trace of length n is carried:

    Σ_t rⁱ_t (z_t + ψ_t) = Σ_t ψ_t (rⁱ_t + c Lⁱ_t),   Lⁱ_t = rⁱ_{t+1} + β Lⁱ_{t+1},   c = 1 ("paper") or β ("usual")

An episode is simulated forward, runs in the inner loop to fill the processor's pipelines, then walked backward
gathering G[q] = Σ (rⁱ_t + c Lⁱ_t) for each pair q = (state, action); the scores enter once, by Σ_q ψ(q) G[q]. A step
costs the same for any number of states and actions up to their search, and hardly more for four channels than for one.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cpgrl_opt import direct_step
from cpgrl_opt.arrays import Float
from envs.interface import FiniteKernel, random_state
from envs.interface.random_stream import next_word

from ..kernels import helper, late
from ..policies import SoftmaxTable
from .finite_rollout import contract, drawn, tabulate, transition_thresholds
from .interface import Estimate
from .learned_episodes import LearnedEpisodes
from .reported_gradient import channels_from_start, require_updates
from .stored_average import StoredAverage, sum_of_weights

if TYPE_CHECKING:
    from .gpomdp import GPOMDP

_LANES = 4  # channels handled together, one vector register of float64
_STEPS_AHEAD = 50_000  # of the environment in one call, at the most: about a millisecond


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
        lanes = -(-channels // _LANES) * _LANES
        rewards = np.zeros((states * actions, lanes))
        rewards[:, :channels] = mdp.rewards.reshape(channels, -1).T
        self.steps = int(settings.steps)
        first = 1 if settings.weights == "paper" else 0  # step of the first reward that enters
        following = 1.0 if settings.weights == "paper" else settings.trace_decay  # c
        self.average = StoredAverage(settings, len(streams), channels)
        by_episode, rate = self.average.by_episode, float(settings.average_rate)
        require_updates(settings.weights, settings.gradient, by_episode, self.steps)
        # Episodes are equally long: for a report per step the mean over the updates is right, see `ReportedGradient`.
        summed = by_episode & (settings.gradient == "reported")
        self.gain = sum_of_weights(rate, self.steps - first)
        self.shape = (len(streams), channels, states * actions)
        self.taken, self.events = np.full(len(streams), self.steps), np.zeros(len(streams), dtype=np.int64)
        self.arguments = (  # of the kernels, in their order
            transition_thresholds(mdp, policy),
            rewards,
            mdp.start,
            self.steps,
            first,
            channels_from_start(settings.weights, settings.gradient, by_episode),
            np.where(summed, 1.0, max(self.steps - first, 1)),
            float(settings.trace_decay),
            following,
            rate,
            np.array([random_state(stream) for stream in streams]),
            self.average.per_step,
        )

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """One episode of each run in one compiled call."""
        gradients = np.empty(self.shape)
        rewards = np.empty(self.shape[:2])
        advance(np.ascontiguousarray(parameters), *self.arguments, gradients, rewards)
        if not self.average.settled:
            self.average.totals[:] += self.gain * (1.0 - self.average.totals)
        return Estimate(self.average.store(rewards), gradients, self.taken.copy(), rewards, self.events.copy())

    def learned_episodes(
        self, parameters: Float[np.ndarray, "B n"], step: tuple[Any, ...], most: int
    ) -> LearnedEpisodes | None:
        """Only where ρ is simply the average per step: not early in training, nor for a report per episode."""
        runs, channels, n = self.shape
        if not self.average.settled or self.average.any_by_episode or len(step[0]) != channels - 1:
            return None
        count = max(1, min(most, _STEPS_AHEAD // (runs * self.steps)))
        arrays = (
            np.empty((count + 1, runs, n)),
            np.empty((count, runs, channels)),
            np.empty((count, *self.shape)),
            np.empty((count, runs, channels)),
            np.empty((count, runs, channels - 1), np.bool_),
            np.empty((count, runs), np.int64),
            np.empty((count, runs, n)),
        )
        arrays[0][0] = parameters
        return LearnedEpisodes(learn(*self.arguments, *step, *arrays), *arrays, self.taken, self.events)


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
            a = drawn(actions[run, s], word >> np.uint64(32))
            visits[t, run] = s * choices + a
            state[run] = drawn(transitions[s, a], word & np.uint64(0xFFFFFFFF))


@helper
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


@late(
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


_advance, _move = advance.helper, direct_step.move.helper


@late(
    "int64(uint64[:, :, ::1], float64[:, ::1], int64, int64, int64, boolean[::1], float64[::1], float64, float64, "
    "float64, uint64[:, ::1], float64[:, ::1], float64[::1], boolean, boolean, boolean, float64, float64, float64, "
    "float64, float64, float64[:, :, ::1], float64[:, :, ::1], float64[:, :, :, ::1], float64[:, :, ::1], "
    "boolean[:, :, ::1], int64[:, ::1], float64[:, :, ::1])"
)
def learn(  # type: ignore[no-untyped-def]
    transitions,
    rewards,
    start,
    steps,
    first,
    from_start,
    divisors,
    trace_decay,
    following,
    average_rate,
    random_states,
    averages,
    thresholds,  # (m,)
    tangent_solver,  # this and the next six as `move` has them
    is_equality,
    restores_inside,
    step_size,
    restoration_rate,
    tolerance,
    relative,
    max_change,
    parameters,  # (1 + K, B, n), the first given, the others filled
    values,  # (K, B, 1 + m), filled, as are the others
    gradients,  # (K, B, 1 + m, n)
    reward_sums,  # (K, B, 1 + m)
    active,  # (K, B, m)
    flat,  # (K, B)
    change,  # (K, B, n)
):
    """K episodes, each with the usual update of θ: 𝒜 = {i: ρⁱ ≤ Gⁱ}, then `move`.

    Returns how many updates were made: where it is less than K, one more episode is there, whose update is not the
    usual one, or not finite, or too far.
    """
    count, runs, n = change.shape
    slack = np.empty((runs, thresholds.size))
    for k in range(count):
        _advance(
            parameters[k], transitions, rewards, start, steps, first, from_start, divisors, trace_decay, following,
            average_rate, random_states, averages, gradients[k], reward_sums[k],
        )  # fmt: skip
        values[k] = averages
        usual = True
        for run in range(runs):
            for i in range(averages.shape[1]):
                usual = usual and abs(values[k, run, i]) < np.inf and abs(reward_sums[k, run, i]) < np.inf
            for i in range(thresholds.size):
                slack[run, i] = values[k, run, 1 + i] - thresholds[i]
                active[k, run, i] = slack[run, i] <= 0.0
                usual = usual and abs(slack[run, i]) < np.inf
        usual = usual and _move(
            gradients[k], slack, active[k], tangent_solver, is_equality, restores_inside, step_size, restoration_rate,
            tolerance, relative, flat[k], change[k],
        )  # fmt: skip
        for run in range(runs):
            for j in range(n):
                parameters[k + 1, run, j] = parameters[k, run, j] + change[k, run, j]
                near = abs(change[k, run, j]) <= max_change and abs(parameters[k + 1, run, j]) < np.inf
                usual = usual and near
        if not usual:
            return k
    return count
