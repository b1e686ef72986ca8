"""Konda's actor-critic: policy gradients of all reward channels from one critic for each."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cpgrl_opt.arrays import Float, Vector
from cpgrl_opt.validation import require_count, require_positive, require_within

from ..policies import NormalizedGaussianNetwork, Policy, SoftmaxTable
from ..rollout import Step, act, episode, located, require_fitting, reward_channels
from ..streams import MOST_COUNTED
from .compiled_path import continuous_kernels_for, finite_kernel_for, require_one_class
from .interface import Estimate, Estimation
from .reported_gradient import ReportedGradient, require_gradient
from .stored_average import StoredAverage, kinds_of_average, require_average_settings


@dataclass(frozen=True, kw_only=True)
class KondaActorCritic:
    """Qⁱ(x, u) = wⁱᵀψ(x, u),   Δⁱ ← mean of Qⁱ(x_t, u_t) ψ_t,   at every step, in this order:

        Δⁱ ← Δⁱ + (wⁱᵀψ_t ψ_t − Δⁱ)/(t + 1)            eq. 5
        z ← βz + ψ_t
        ρⁱ ← ρⁱ + α_r (rⁱ_t − ρⁱ)                      eq. 4
        δⁱ = rⁱ_t − ρⁱ + wⁱᵀ(ψ_{t+1} − ψ_t)
        wⁱ ← wⁱ + α_w δⁱ z

    rⁱ_t is what (x_t, u_t) yields. The paper prints r_{t+1}, with which Q(x_t, u_t) would lose its own reward; its
    limit is then off the exact gradient by more than half, against 0.003–0.011 (docs/reproduction.md, slip 9).
    z and Δ restart with each episode; w and ρ go on (§2.4 as we read it; resetting w kills learning). ψ_{t+1} = 0
    after an event that ends the episode; at the time limit one more action is drawn to bootstrap from.

    Δ is the gradient of the ρ that `average` reports, also where episodes differ in length. Given the past of step t,
    E[ψ_t] = 0, so E[z ψ_{t+1}ᵀ] = 0, E[z ψ_tᵀ] = E[ψ_t ψ_tᵀ], and where w settles (sums over an episode of T steps)

        E[Σ_t ψ_t ψ_tᵀ] wⁱ = E[Σ_t (rⁱ_t − ρⁱ) z]  →  ∇E[Σ_t rⁱ_t] − ρⁱ ∇E[T]    as β → 1

    "step"     reports E[Σ rⁱ]/E[T]: Δⁱ = Σ_t Qⁱψ_t / (mean number of steps), eq. 5 where episodes are equally long
    "episode"  reports E[Σ rⁱ]: this channel's critic subtracts no ρ, its sum ends at the time limit (ψ_{t+1} = 0), and
               Δⁱ = Σ_t Qⁱψ_t
    gradient "episode mean" is eq. 5 as printed: ρ per step subtracted in every critic, and the mean over each episode's
    own steps, whatever `average` says. `ReportedGradient` says which mean number of steps it is.

    α_w ‖ψ‖² well below 1 keeps w bounded: with a Gaussian policy, whose ψ grows as 1/σ, σ ~ 1 in the unit of u.
    As the critic settles, w tends to the fixed point of TD(β) and Δ to E[ψψᵀ]w, as β → 1 to the exact gradient.
    That holds for small rates. At the paper's, α_r/(1 − β) = 2: ρ follows rewards as fast as z forgets, and on the
    three-state MDP the mean of Δ points the same way (cosine > 0.99) but is half as long.

    trace_decay β: in [0, 1); average_rate α_r: in [0, 1]; critic_rate α_w: > 0, the paper's is α_r.
    average: "step" or "episode", for all channels or for each, and bias_correction, of an average that starts at 0: see
    `StoredAverage`; the ρ per step that critics subtract is corrected likewise. steps: an episode's time limit, unless
    the environment's own is shorter.
    A finite MDP with a `SoftmaxTable` and a `ContinuousEnvironment` with a `NormalizedGaussianNetwork` run compiled.
    Any other pair takes the generic path: a Gymnasium environment with vector rewards.
    Source: eq. 5 of the paper and the equations after it; Konda & Tsitsiklis (2003).
    """

    trace_decay: float = 0.99
    average_rate: float = 0.02
    critic_rate: float = 0.02
    average: str | Sequence[str] = "step"
    steps: int = 1000
    gradient: str = "reported"
    bias_correction: bool = True

    def __post_init__(self) -> None:
        require_within("trace_decay", self.trace_decay, "[0, 1)")
        require_positive("critic_rate", self.critic_rate)  # at 0 critics, and Δ, would stay 0
        object.__setattr__(self, "average", kinds_of_average(self.average))
        require_average_settings(self)
        require_count("steps", self.steps, most=MOST_COUNTED)
        require_gradient(self.gradient)

    def start(self, environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence]) -> Estimation:
        """Compiled where kernels stand for environment and policy (`compiled_path`), generic otherwise."""
        require_one_class(environment, policy, self.average)
        mdp, kernels = finite_kernel_for(environment, policy), continuous_kernels_for(environment, policy)
        if mdp is not None and isinstance(policy, SoftmaxTable):
            from .finite_konda import FiniteKonda  # numba loads here

            return FiniteKonda(self, mdp, policy, streams)
        if kernels is not None and isinstance(policy, NormalizedGaussianNetwork):
            from .continuous_konda import ContinuousKonda  # and here

            return ContinuousKonda(self, kernels, policy, streams)
        return RolloutKonda(self, environment, policy, streams)


class RolloutKonda:
    """The generic path: any Gymnasium environment with vector rewards, any policy; a plain loop.

    One environment serves all runs: each episode resets it with a seed from the run's own stream (`rollout.episode`).
    """

    carried = ("rngs", "average", "reported", "critics")

    def __init__(
        self, settings: KondaActorCritic, environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence]
    ) -> None:
        self.settings = settings
        self.environment = environment
        self.policy = policy
        self.rngs = [np.random.default_rng(stream) for stream in streams]
        channels = reward_channels(environment)
        require_fitting(environment, policy)
        runs = len(self.rngs)
        self.average = StoredAverage(settings, runs, channels)
        as_printed = settings.gradient == "episode mean"
        self.reported = ReportedGradient(self.average.by_episode, settings.average_rate, runs, as_printed=as_printed)
        self.centred = np.where(self.average.by_episode & (not as_printed), 0.0, 1.0)
        self.critics = np.zeros((len(self.rngs), channels, len(policy.parameters)))

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """One episode of each run."""
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows shows in the estimate
            runs = [self._run(run, theta) for run, theta in enumerate(parameters)]
            means, steps, rewards, events = (np.array(part) for part in zip(*runs, strict=True))
            gradients = self.reported.convert(means, steps, rewards)
        return Estimate(self.average.store(rewards), gradients, steps, rewards, events)

    def _run(self, run: int, theta: Vector) -> tuple[np.ndarray, int, np.ndarray, int]:
        policy, rng = self.policy.with_parameters(theta), self.rngs[run]
        course = _Course(self.settings, self.centred, self.average, run, self.critics[run])
        last: Step | None = None
        for step in episode(self.environment, policy, rng, self.settings.steps, run):
            if last is not None:
                course.advance(last.reward, step.score)
            course.score = step.score
            last = step
        assert last is not None  # the limit is at least one step
        following = np.zeros_like(course.score)
        if not last.event:
            with located(self.environment, course.steps + 1, run):
                _, following = act(policy, last.following, rng)
        course.advance(last.reward, following, last=True)
        return course.gradients, course.steps, course.rewards, last.event


class _Course:
    """One episode: z and Δ from zero; ρ and w, (1 + m,) and (1 + m, n), are advanced in place.

    centred: (1 + m,), 1 where the critic subtracts ρ, 0 where a sum over the episode is reported.
    """

    def __init__(
        self, settings: KondaActorCritic, centred: np.ndarray, stored: StoredAverage, run: int, critics: np.ndarray
    ) -> None:
        self.settings = settings
        self.centred = centred
        self.average, self.total = stored.per_step[run], stored.totals[run : run + 1]
        self.critics = critics
        self.score = self.trace = np.zeros(critics.shape[1])
        self.gradients, self.rewards = np.zeros_like(critics), np.zeros_like(self.average)
        self.steps = 0

    def advance(self, reward: np.ndarray, following: np.ndarray, *, last: bool = False) -> None:
        """The step with score ψ_t that yielded `reward` and was followed by ψ_{t+1}; a sum ends with the last one."""
        settings, score = self.settings, self.score
        self.steps += 1
        self.rewards += reward
        self.gradients += (np.outer(self.critics @ score, score) - self.gradients) / self.steps  # eq. 5
        self.trace = settings.trace_decay * self.trace + score
        self.average += settings.average_rate * (reward - self.average)  # eq. 4
        self.total += settings.average_rate * (1.0 - self.total)
        delta = reward - self.centred * (self.average / self.total) + self.critics @ (following - score)
        if last:
            delta -= (1.0 - self.centred) * (self.critics @ following)
        self.critics += settings.critic_rate * np.outer(delta, self.trace)
