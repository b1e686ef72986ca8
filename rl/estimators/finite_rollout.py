"""What compiled estimators share on a finite MDP with a softmax table: draws by 32-bit thresholds, and Σ ψ G."""

import numpy as np

from cpgrl_opt.arrays import UInt64
from envs.interface import FiniteKernel

from ..kernels import helper
from ..policies import SoftmaxTable

WORD = 2.0**32  # a draw is 32 bits: events rarer than 2⁻³² per step do not occur


def transition_thresholds(mdp: FiniteKernel, policy: SoftmaxTable) -> UInt64[np.ndarray, "S A S"]:
    """The least draws beyond each next state; ValueError when the policy's table does not fit the kernel."""
    _, states, actions = mdp.rewards.shape
    if (policy.states, policy.actions) != (states, actions):
        raise ValueError(
            f"policy should have {states} states and {actions} actions, as the environment; "
            f"found {policy.states} and {policy.actions}"
        )
    return np.ceil(mdp.transition_cumulative * WORD).astype(np.uint64)


@helper
def tabulate(theta, probabilities, thresholds):  # type: ignore[no-untyped-def]
    """μ(s, a), and the least 32-bit draw that goes beyond action a in state s."""
    states, actions = probabilities.shape
    for s in range(states):
        preferences = theta[s * actions : (s + 1) * actions]
        largest, total, below = preferences[0], 0.0, 0.0
        for a in range(1, actions):
            largest = max(largest, preferences[a])
        for a in range(actions):
            probabilities[s, a] = np.exp(preferences[a] - largest)
            total += probabilities[s, a]
        for a in range(actions):
            probabilities[s, a] /= total
            below += probabilities[s, a]
            thresholds[s, a] = np.uint64(np.ceil(below * WORD))


@helper
def drawn(thresholds, draw):  # type: ignore[no-untyped-def]
    """The first j with draw < thresholds[j], the last if none; the last is not compared.

    Unsigned, so that an index made of it is not looked at for being negative.
    """
    last = thresholds.size - 1
    if last == 2:  # a quarter of an episode's time would go into counting a loop's rounds
        return np.uint64(draw >= thresholds[0]) + np.uint64(draw >= thresholds[1])
    if last > 16:
        return np.uint64(min(np.searchsorted(thresholds, draw, side="right"), last))
    count = np.uint64(0)
    for j in range(last):  # without a branch: none is mispredicted
        count += np.uint64(draw >= thresholds[j])
    return count


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
