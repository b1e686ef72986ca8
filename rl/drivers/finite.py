"""The driver of finite MDPs with a softmax table, compiled: B runs play an episode in one call.

A draw is 32 bits: events rarer than 2⁻³² per step do not occur. One word a step: its high half draws the action, its
low half the next state. ψ is zero outside its state, so a step costs a rule A numbers, but for what is of θ's length.
"""

from collections.abc import Sequence

import numpy as np

from cpgrl_opt.arrays import Float, UInt64
from envs.interface import FiniteKernel, random_state
from envs.interface.random_stream import next_word

from .._kernels import helper
from ..policies import SoftmaxTable
from .interface import Batch, RuleStep, Score
from .kernels import account, close_run, driver_signature, kernel, open_run, play

WORD = 2.0**32


class FiniteDriver:
    """B runs of a `SoftmaxTable` on a `FiniteKernel`.

    Raises
    ------
    ValueError
        When the table does not fit the kernel.
    """

    carried = ("random_states",)

    def __init__(
        self, mdp: FiniteKernel, policy: SoftmaxTable, streams: Sequence[np.random.SeedSequence], steps: int
    ) -> None:
        channels, states, actions = mdp.rewards.shape
        self.mdp, self.limit = mdp, int(steps)
        self.shape = (len(streams), channels, states * actions)
        self.transitions = transition_thresholds(mdp, policy)
        self.rewards = np.ascontiguousarray(mdp.rewards.reshape(channels, -1).T)
        self.random_states = np.array([random_state(stream) for stream in streams])

    def play(self, step: RuleStep, parameters: Float[np.ndarray, "B n"], batch: Batch) -> None:
        """One episode of each run in one call."""
        fixed = (self.transitions, self.rewards, self.mdp.start, self.limit)
        play(advance, step, {}, *fixed, parameters, self.random_states, batch)

    def reorder(self, vectors: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n"]:
        """As they are."""
        return vectors


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
def pick(thresholds, draw):  # type: ignore[no-untyped-def]
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
def _write_score(probabilities, action, values):  # type: ignore[no-untyped-def]
    """1[b = a] − μ(s, b)."""
    for b in range(values.size):
        values[b] = -probabilities[b]
    values[action] += 1.0


@kernel(
    driver_signature(
        "uint64[:, :, ::1], float64[:, ::1], int64, int64, float64[:, ::1], uint64[:, ::1]",
    )
)
def advance(rule, transitions, rewards, start, limit, parameters, random_states, batch):  # type: ignore[no-untyped-def]
    """One episode of B runs, one after the other; transitions: (S, A, S) least draws; rewards: (S·A, 1 + m)."""
    states, actions = transitions.shape[:2]
    probabilities, thresholds = np.empty((states, actions)), np.empty((states, actions), np.uint64)
    scores = np.empty((2, actions))
    for run in range(parameters.shape[0]):
        course, random = open_run(batch, run), random_states[run]
        tabulate(parameters[run], probabilities, thresholds)
        s = start
        word = next_word(random)
        a = np.int64(pick(thresholds[s], word >> np.uint64(32)))
        _write_score(probabilities[s], a, scores[0])
        for t in range(limit):
            score, following, last = scores[t % 2], scores[1 - t % 2], t + 1 == limit
            place, reward = s * actions, rewards[s * actions + a]
            s = np.int64(pick(transitions[s, a], word & np.uint64(0xFFFFFFFF)))
            if batch.looks_ahead or not last:
                word = next_word(random)
                a = np.int64(pick(thresholds[s], word >> np.uint64(32)))
                _write_score(probabilities[s], a, following)
            else:
                following[:] = 0.0
            account(batch, run, t, reward)
            rule(course, t, Score(place, score), reward, Score(s * actions, following), last)
        close_run(batch, run, limit, 0)
