"""GPOMDP: policy gradients of all reward channels from one trace."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.validation import require_count, require_member, require_within

from ..policies import NormalizedGaussianNetwork, Policy, SoftmaxTable
from ..rollout import episode, require_fitting, reward_channels
from ..streams import MOST_COUNTED
from .compiled_path import continuous_kernels_for, finite_kernel_for, require_one_class
from .interface import Estimate, Estimation
from .reported_gradient import ReportedGradient, UpdateWatch, channels_from_start, require_gradient, require_updates
from .stored_average import StoredAverage, kinds_of_average, require_average_settings

WEIGHTS = ("paper", "usual")


@dataclass(frozen=True, kw_only=True)
class GPOMDP:
    """z ← βz + ψ,  Δⁱ ← mean of rⁱ(z + ψ),  ρⁱ ← ρⁱ + α_r (rⁱ − ρⁱ): one trace for all channels.

    With weights "paper", eq. 3 as printed: rⁱ(x_t, u_t) meets z_t + ψ_t, z_t = Σ_{k<t} βᵗ⁻¹⁻ᵏ ψ_k, so a score is
    weighted 1, 1, β, β², … with the rewards from its own step on; r(x₀, u₀) enters neither Δ nor ρ, and an episode of
    T steps makes T − 1 updates. With "usual", rⁱ(x_t, u_t) meets z_{t+1}: weights 1, β, β², …, T updates.
    z and Δ restart with each episode; ρ goes on from the last one's (our reading of §2.4, which breaks off).

    Δ is the gradient of the ρ that `average` reports, also where episodes differ in length (`ReportedGradient` derives
    it): with "episode" the sum Σ_t rⁱ(z + ψ), with "step" Σ_t (rⁱ − ρⁱ)(z + ψ) over the mean number of updates, which
    is eq. 3's mean where all episodes are equally long. With weights "paper" the report per step leaves the first step
    out too: it is E[Σ_{t≥1} rⁱ]/E[T − 1]. The report per episode is the whole sum, so there r(x₀, u₀) meets ψ₀ in Δ.
    gradient "episode mean" is eq. 3 as printed, the mean over each episode's own updates whatever `average` says.

    trace_decay β: in [0, 1); average_rate α_r: in [0, 1]; steps T: an episode's time limit, unless the environment's
    own is shorter. average: "step" or "episode", for all channels or for each, and bias_correction, of an average
    that starts at 0: see `StoredAverage`.
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
    gradient: str = "reported"
    bias_correction: bool = True

    def __post_init__(self) -> None:
        require_within("trace_decay", self.trace_decay, "[0, 1)")
        require_member("weights", self.weights, tuple(WEIGHTS))
        require_count("steps", self.steps, most=MOST_COUNTED)
        object.__setattr__(self, "average", kinds_of_average(self.average))
        require_average_settings(self)
        require_gradient(self.gradient)

    def start(self, environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence]) -> Estimation:
        """Compiled where kernels stand for environment and policy (`compiled_path`), generic otherwise."""
        require_one_class(environment, policy, self.average)
        mdp, kernels = finite_kernel_for(environment, policy), continuous_kernels_for(environment, policy)
        if mdp is not None and isinstance(policy, SoftmaxTable):
            from .finite_gpomdp import FiniteGPOMDP  # numba loads here

            return FiniteGPOMDP(self, mdp, policy, streams)
        if kernels is not None and isinstance(policy, NormalizedGaussianNetwork):
            from .continuous_gpomdp import ContinuousGPOMDP  # and here

            return ContinuousGPOMDP(self, kernels, policy, streams)
        return RolloutGPOMDP(self, environment, policy, streams)


class RolloutGPOMDP:
    """The generic path: any Gymnasium environment with vector rewards, any policy; a plain loop.

    One environment serves all runs: each episode resets it with a seed from the run's own stream (`rollout.episode`).
    """

    carried = ("rngs", "average", "reported", "watch")

    def __init__(
        self, settings: GPOMDP, environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence]
    ) -> None:
        self.settings = settings
        self.environment = environment
        self.policy = policy
        self.rngs = [np.random.default_rng(stream) for stream in streams]
        channels = reward_channels(environment)
        require_fitting(environment, policy)
        runs = len(self.rngs)
        self.average = StoredAverage(settings, runs, channels)
        by_episode = self.average.by_episode
        require_updates(settings.weights, settings.gradient, by_episode, settings.steps)
        self.from_start = channels_from_start(settings.weights, settings.gradient, by_episode)
        self.watch = None if self.from_start.all() else UpdateWatch()
        self.reported = ReportedGradient(
            self.average.by_episode, settings.average_rate, runs, as_printed=settings.gradient == "episode mean"
        )

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """One episode of each run."""
        played = [self._run(run, theta) for run, theta in enumerate(parameters)]
        means, updates, entered, spans, steps, rewards, events = (
            np.array([getattr(each, name) for each in played])
            for name in ("gradients", "updates", "entered", "span", "steps", "rewards", "event")
        )
        if self.watch is not None:
            self.watch.see(updates)
        gradients = self.reported.convert(means, updates, entered, spans)
        return Estimate(self.average.store(rewards), gradients, steps, rewards, events)

    def _run(self, run: int, theta: Vector) -> "_PlainEpisode":
        policy = self.policy.with_parameters(theta)
        course = _PlainEpisode(self.settings, self.from_start, self.average, run, len(theta))
        for step in episode(self.environment, policy, self.rngs[run], self.settings.steps, run):
            course.advance(step.reward, step.score)
            course.event = step.event
        return course


class _PlainEpisode:
    """One episode: z and Δ from zero; ρ, (1 + m,), is advanced in place.

    mean: of r met over `updates`; first: r(x₀, u₀) ψ₀ where it comes on top; span: Σ_t of what the rewards met;
    entered: Σ_t of the rewards in `mean`.
    """

    def __init__(self, settings: GPOMDP, from_start: np.ndarray, stored: StoredAverage, run: int, n: int) -> None:
        self.settings = settings
        self.from_start = from_start
        self.average, self.total = stored.per_step[run], stored.totals[run : run + 1]
        self.trace, self.span = np.zeros(n), np.zeros(n)
        self.mean, self.first = np.zeros((2, len(self.average), n))
        self.rewards, self.entered = np.zeros((2, len(self.average)))
        self.updates = self.steps = self.event = 0

    def advance(self, reward: np.ndarray, score: np.ndarray) -> None:
        """The step with score ψ_t that yielded `reward`."""
        beta, paper = self.settings.trace_decay, self.settings.weights == "paper"
        if self.steps > 0 or not paper:
            self.updates += 1
            met = self.trace + score if paper else beta * self.trace + score
            self.mean += (np.outer(reward, met) - self.mean) / self.updates  # eq. 3
            self.average += self.settings.average_rate * (reward - self.average)  # eq. 4, in place
            self.total += self.settings.average_rate * (1.0 - self.total)
            self.span += met
            self.entered += reward
        else:
            self.first[self.from_start] = np.outer(reward[self.from_start], score)
        self.trace = beta * self.trace + score
        self.rewards += reward
        self.steps += 1

    @property
    def gradients(self) -> np.ndarray:
        """Δ over the number of updates, (1 + m, n)."""
        return self.mean + self.first / max(self.updates, 1)
