"""Konda's actor-critic on a finite MDP with a softmax table, compiled: B runs advance one episode in one call.

A score is zero outside its state, so wᵀψ costs A products, and Q enters Δ through sums for each pair (state, action):
Δⁱ = (1/T) Σ_q ψ(q) Σ_{t: q_t = q} Qⁱ. Only the trace and w itself are of θ's length at every step.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cpgrl_opt.arrays import Float
from envs.interface import FiniteKernel, random_state
from envs.interface.random_stream import next_word

from ..kernels import helper, kernel
from ..policies import SoftmaxTable
from .finite_rollout import contract, drawn, tabulate, transition_thresholds
from .interface import Estimate
from .stored_average import StoredAverage

if TYPE_CHECKING:
    from .konda_actor_critic import KondaActorCritic


class FiniteKonda:
    """B runs of `KondaActorCritic` on a `FiniteKernel`; carries ρ, w and the random states.

    Draws as in `FiniteGPOMDP`, and one more at an episode's end for the action to bootstrap from.
    Raises ValueError when the policy's table does not fit the kernel.
    """

    carried = ("random_states", "average", "critics")

    def __init__(
        self,
        settings: "KondaActorCritic",
        mdp: FiniteKernel,
        policy: SoftmaxTable,
        streams: Sequence[np.random.SeedSequence],
    ) -> None:
        channels, states, actions = mdp.rewards.shape
        self.transitions = transition_thresholds(mdp, policy)
        runs = len(streams)
        self.rewards = np.ascontiguousarray(mdp.rewards.reshape(channels, -1).T)
        self.start = mdp.start
        self.steps = int(settings.steps)
        self.rates = (float(settings.trace_decay), float(settings.average_rate), float(settings.critic_rate))
        self.random_states = np.array([random_state(stream) for stream in streams])
        self.average = StoredAverage(settings, runs, channels)
        summed = self.average.by_episode & (settings.gradient == "reported")
        self.centred = np.where(summed, 0.0, 1.0)
        self.divisors = np.where(summed, 1.0, self.steps)  # episodes are equally long: see `ReportedGradient`
        self.critics = np.zeros((runs, channels, states * actions))

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """One episode of each run in one compiled call."""
        gradients, rewards = np.empty(self.critics.shape), np.empty(self.critics.shape[:2])
        advance(
            np.ascontiguousarray(parameters),
            self.transitions,
            self.rewards,
            self.start,
            self.steps,
            *self.rates,
            self.centred,
            self.divisors,
            self.random_states,
            self.average.per_step,
            self.average.totals,
            self.critics,
            gradients,
            rewards,
        )
        runs = len(self.random_states)
        none = np.zeros(runs, dtype=np.int64)
        return Estimate(self.average.store(rewards), gradients, np.full(runs, self.steps), rewards, none)


@helper
def _value(critic, probabilities, action):  # type: ignore[no-untyped-def]
    """wᵀψ(s, a) from the state's row of w and of μ: w_a − Σ_b μ_b w_b."""
    value = critic[action]
    for b in range(critic.size):
        value -= probabilities[b] * critic[b]
    return value


@helper
def _extend(decay, probabilities, state, action, trace):  # type: ignore[no-untyped-def]
    """z ← βz + ψ(s, a); z: (S, A)."""
    for s in range(trace.shape[0]):
        for b in range(trace.shape[1]):
            trace[s, b] *= decay
    for b in range(probabilities.size):
        trace[state, b] -= probabilities[b]
    trace[state, action] += 1.0


@helper
def _add(change, trace, critic):  # type: ignore[no-untyped-def]
    """w ← w + α_w δ z."""
    flat = trace.ravel()
    for j in range(critic.size):
        critic[j] += change * flat[j]


@kernel(
    "void(float64[:, ::1], uint64[:, :, ::1], float64[:, ::1], int64, int64, float64, float64, float64, float64[::1], "
    "float64[::1], uint64[:, ::1], float64[:, ::1], float64[::1], float64[:, :, ::1], float64[:, :, ::1], "
    "float64[:, ::1])"
)
def advance(  # type: ignore[no-untyped-def]
    parameters,  # (B, S·A)
    transitions,  # (S, A, S) least draws beyond each next state
    rewards,  # (S·A, 1 + m)
    start,
    steps,
    trace_decay,
    average_rate,
    critic_rate,
    centred,  # (1 + m,), 1 where the critic subtracts ρ, 0 where a sum over the episode is reported
    divisors,  # (1 + m,), of Δ
    random_states,  # (B, 4), advanced
    averages,  # (B, 1 + m), advanced
    totals,  # (B,), advanced: the weights in `averages`, whose quotient is ρ
    critics,  # (B, 1 + m, S·A), advanced
    gradients,  # (B, 1 + m, S·A), filled
    reward_sums,  # (B, 1 + m), filled
):
    """One episode of B runs, one after the other."""
    states, actions = transitions.shape[:2]
    probabilities, thresholds = np.empty((states, actions)), np.empty((states, actions), np.uint64)
    trace, gathered = np.empty((states, actions)), np.empty(rewards.shape)
    for run in range(parameters.shape[0]):
        tabulate(parameters[run], probabilities, thresholds)
        trace[:], gathered[:], reward_sums[run] = 0.0, 0.0, 0.0
        s = start
        word = next_word(random_states[run])
        a = np.int64(drawn(thresholds[s], word >> np.uint64(32)))
        for t in range(steps):
            taken, q = a, s * actions + a
            _extend(trace_decay, probabilities[s], s, a, trace)
            following = np.int64(drawn(transitions[s, a], word & np.uint64(0xFFFFFFFF)))
            word = next_word(random_states[run])
            a = np.int64(drawn(thresholds[following], word >> np.uint64(32)))
            totals[run] += average_rate * (1.0 - totals[run])
            for i in range(rewards.shape[1]):
                critic, reward = critics[run, i], rewards[q, i]
                value = _value(critic[s * actions : (s + 1) * actions], probabilities[s], taken)
                gathered[q, i] += value
                reward_sums[run, i] += reward
                averages[run, i] += average_rate * (reward - averages[run, i])
                next_row = critic[following * actions : (following + 1) * actions]
                later = _value(next_row, probabilities[following], a)
                if t == steps - 1:
                    later *= centred[i]  # a sum ends here
                delta = reward - centred[i] * (averages[run, i] / totals[run]) + later - value
                _add(critic_rate * delta, trace, critic)
            s = following
        contract(gathered, probabilities, divisors, gradients[run])
