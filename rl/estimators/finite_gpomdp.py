"""GPOMDP on a finite MDP with a softmax table, compiled: B runs advance one episode in one call."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from cpgrl_opt.arrays import Float

from ..drivers.finite import FiniteDriver
from .finite_gpomdp_kernels import LANES, advance
from .interface import Estimate
from .learned_episodes import LearnedEpisodes
from .sampling import Sampling
from .stored_average import sum_of_weights

if TYPE_CHECKING:
    from .gpomdp import GPOMDP

# At the most in one call: steps of the environment, about a millisecond, and numbers of gradients, four megabytes.
_STEPS_AHEAD, _NUMBERS_AHEAD = 50_000, 500_000


class FiniteGPOMDP(Sampling):
    """B runs of GPOMDP on a finite MDP: the driver's draws, and fifteen times the speed of its rule step by step."""

    carried = ("random_states", "average")

    def __init__(self, settings: "GPOMDP", driver: FiniteDriver) -> None:
        super().__init__(settings, driver)
        runs, channels, n = self.shape = driver.shape
        lanes = -(-channels // LANES) * LANES
        rewards = np.zeros((n, lanes))
        rewards[:, :channels] = driver.rewards
        self.steps = driver.limit
        following = 1.0 if settings.weights == "paper" else settings.trace_decay  # c
        rule, rate = self.rule, float(settings.average_rate)
        self.gain = sum_of_weights(rate, self.steps - rule.first)
        self.taken, self.events = np.full(runs, self.steps), np.zeros(runs, dtype=np.int64)
        self.random_states = driver.random_states
        self.arguments = (  # of the kernels, in their order
            driver.transitions,
            rewards,
            driver.mdp.start,
            self.steps,
            rule.first,
            self.batch.from_start,
            # episodes are equally long, so per step the mean over the updates is right: see `ReportedGradient`
            np.where(self.reported.summed, 1.0, max(self.steps - rule.first, 1)),
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
