"""GPOMDP: policy gradients of all reward channels from one trace."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from cpgrl_opt.arrays import Vector

from ..policies import NormalizedGaussianNetwork, Policy, SoftmaxTable
from ..policies.interface import require_count
from ..rollout import episode, require_fitting, reward_channels
from .interface import Estimate, Estimation
from .stored_average import StoredAverage, require_averages

WEIGHTS = ("paper", "usual")


@dataclass(frozen=True, kw_only=True)
class GPOMDP:
    """z ← βz + ψ,  Δⁱ ← mean of rⁱ(z + ψ),  ρⁱ ← ρⁱ + α_r (rⁱ − ρⁱ): one trace for all channels.

    With weights "paper", eq. 3 as printed: rⁱ(x_t, u_t) meets z_t + ψ_t, z_t = Σ_{k<t} βᵗ⁻¹⁻ᵏ ψ_k, so a score is
    weighted 1, 1, β, β², … with the rewards from its own step on; r(x₀, u₀) enters neither Δ nor ρ, and an episode of
    T steps makes T − 1 updates. With "usual", rⁱ(x_t, u_t) meets z_{t+1}: weights 1, β, β², …, T updates.
    z and Δ restart with each episode; ρ goes on from the last one's (our reading of §2.4, which breaks off).

    trace_decay β: in [0, 1); average_rate α_r: in [0, 1]; steps T: an episode's time limit, unless the environment's
    own is shorter. average: "step" or "episode", for all channels or for each, see `StoredAverage`.
    Bias, the price of β < 1: ‖limit for T → ∞ − ∇gⁱ‖ / ‖∇gⁱ‖ is at most 0.014, 0.0014, 0.00014 at β = 0.9, 0.99, 0.999
    over the channels of the three-state MDP and 1000 policies θ ~ U[0, 1]⁹; with "usual" 0.064, 0.0065, 0.00065.
    A finite MDP with a `SoftmaxTable` runs compiled, keeping 4 bytes of each step, and so does a
    `ContinuousEnvironment` with a `NormalizedGaussianNetwork`, keeping none. Any other pair takes the generic path:
    a Gymnasium environment with vector rewards that `reset(seed=…)` starts anew.
    Source: eq. 3 and 4 of the paper; Baxter & Bartlett (2001).
    """

    trace_decay: float = 0.99
    average_rate: float = 0.02
    weights: str = "paper"
    steps: int = 100
    average: str | Sequence[str] = "step"

    def __post_init__(self) -> None:
        if not 0 <= self.trace_decay < 1:
            raise ValueError(f"trace_decay should be in [0, 1); found {self.trace_decay!r}")
        if not 0 <= self.average_rate <= 1:
            raise ValueError(f"average_rate should be in [0, 1]; found {self.average_rate!r}")
        if self.weights not in WEIGHTS:
            raise ValueError(f"weights should be one of {', '.join(WEIGHTS)}; found {self.weights!r}")
        require_count("steps", self.steps)
        if not isinstance(self.average, str):
            object.__setattr__(self, "average", tuple(self.average))
        require_averages(self.average)

    def start(self, environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence]) -> Estimation:
        """Compiled where environment and policy allow it, generic otherwise."""
        from envs.interface import ContinuousEnvironment, FiniteEnvironment  # Gymnasium loads with envs

        if isinstance(environment, FiniteEnvironment) and isinstance(policy, SoftmaxTable):
            from .finite_gpomdp import FiniteGPOMDP  # numba loads here

            return FiniteGPOMDP(self, environment.finite_kernel(), policy, streams)
        if isinstance(environment, ContinuousEnvironment) and isinstance(policy, NormalizedGaussianNetwork):
            from .continuous_gpomdp import ContinuousGPOMDP  # and here

            return ContinuousGPOMDP(self, environment.continuous_kernels(), policy, streams)
        return RolloutGPOMDP(self, environment, policy, streams)


class RolloutGPOMDP:
    """The generic path: any Gymnasium environment with vector rewards, any policy; a plain loop.

    One environment serves all runs: each episode resets it with a seed from the run's own stream.
    """

    def __init__(
        self, settings: GPOMDP, environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence]
    ) -> None:
        self.settings = settings
        self.environment = environment
        self.policy = policy
        self.rngs = [np.random.default_rng(stream) for stream in streams]
        channels = reward_channels(environment)
        require_fitting(environment, policy)
        self.average = StoredAverage(settings.average, settings.average_rate, len(self.rngs), channels)

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """One episode of each run."""
        runs = [self._run(run, theta) for run, theta in enumerate(parameters)]
        gradients, steps, rewards, events = (np.array(part) for part in zip(*runs, strict=True))
        return Estimate(self.average.store(rewards), gradients, steps, rewards, events)

    def _run(self, run: int, theta: Vector) -> tuple[np.ndarray, int, np.ndarray, int]:
        beta, paper = self.settings.trace_decay, self.settings.weights == "paper"
        policy, average = self.policy.with_parameters(theta), self.average.per_step[run]
        trace, rewards = np.zeros(len(theta)), np.zeros(len(average))
        gradients = np.zeros((len(average), len(theta)))
        updates = steps = event = 0
        for step in episode(self.environment, policy, self.rngs[run], self.settings.steps):
            score = policy.score(step.observation, step.action)
            if steps > 0 or not paper:
                updates += 1
                met = trace + score if paper else beta * trace + score
                gradients += (np.outer(step.reward, met) - gradients) / updates  # eq. 3
                average += self.settings.average_rate * (step.reward - average)  # eq. 4, in place
            trace = beta * trace + score
            rewards += step.reward
            steps, event = steps + 1, step.event
        return gradients, steps, rewards, event
