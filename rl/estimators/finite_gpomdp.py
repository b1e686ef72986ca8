"""GPOMDP on a finite MDP with a softmax table, compiled: B runs advance one episode in one call."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cpgrl_opt.arrays import Float
from envs.interface import FiniteKernel, random_state

from ..policies import SoftmaxTable
from .finite_gpomdp_kernels import LANES, advance
from .finite_rollout import transition_thresholds
from .interface import Estimate
from .learned_episodes import LearnedEpisodes
from .reported_gradient import channels_from_start, require_updates
from .stored_average import StoredAverage, sum_of_weights

if TYPE_CHECKING:
    from .gpomdp import GPOMDP

# At the most in one call: steps of the environment, about a millisecond, and numbers of gradients, four megabytes.
_STEPS_AHEAD, _NUMBERS_AHEAD = 50_000, 500_000


class FiniteGPOMDP:
    """B runs of GPOMDP on a `FiniteKernel`; carries ρ and the random states.

    A draw is 32 bits: events rarer than 2⁻³² per step do not occur.
    Raises ValueError when the policy's table does not fit the kernel.
    """

    carried = ("random_states", "average")

    def __init__(
        self,
        settings: "GPOMDP",
        mdp: FiniteKernel,
        policy: SoftmaxTable,
        streams: Sequence[np.random.SeedSequence],
    ) -> None:
        channels, states, actions = mdp.rewards.shape
        lanes = -(-channels // LANES) * LANES
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
        self.random_states = np.array([random_state(stream) for stream in streams])
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
            self.random_states,
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
        from .finite_learning import learn  # loads the kernels of a step too

        count = max(1, min(most, _STEPS_AHEAD // (runs * self.steps), _NUMBERS_AHEAD // math.prod(self.shape)))
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
