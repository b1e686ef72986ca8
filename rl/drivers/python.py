"""The driver of everything else: any Gymnasium environment with vector rewards, any policy; a plain loop."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from cpgrl_opt.arrays import Float, Vector

from .._spaces import require_fitting
from ..channels import reward_channels
from ..policies import Policy
from ..rollout import Step, act, episode, locate_errors
from .interface import Batch, CompiledStep, RuleStep, Score, account, close_run, open_run


class PythonDriver:
    """B runs in one environment: each episode resets it with a seed from the run's own stream (`rollout.episode`)."""

    carried = ("rngs",)

    def __init__(self, environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence], steps: int) -> None:
        self.environment, self.policy, self.limit = environment, policy, int(steps)
        self.rngs = [np.random.default_rng(stream) for stream in streams]
        self.shape = (len(streams), reward_channels(environment), len(policy.parameters))
        require_fitting(environment, policy)

    def play(self, step: RuleStep, parameters: Float[np.ndarray, "B n"], batch: Batch) -> None:
        """One episode of each run."""
        own = step.entry_point if isinstance(step, CompiledStep) else step
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows shows in the estimate
            for run, theta in enumerate(parameters):
                course, t = open_run(batch, run), 0
                for taken, following, last in self._steps(run, self.policy.with_parameters(theta), batch.looks_ahead):
                    account(batch, run, t, taken.reward)
                    own(course, t, Score(0, taken.score), taken.reward, Score(0, following), last)
                    t += 1
                close_run(batch, run, t, taken.event)

    def _steps(self, run: int, policy: Policy, looks_ahead: bool) -> Iterator[tuple[Step, Vector, bool]]:
        """Each step of an episode with ψ_{t+1}, and whether it is the last."""
        steps, count = episode(self.environment, policy, self.rngs[run], self.limit, run), 1
        taken = next(steps)
        for later in steps:
            yield taken, later.score, False
            taken, count = later, count + 1
        following = np.zeros_like(taken.score)
        if looks_ahead and not taken.event:
            with locate_errors(self.environment, count, run):
                _, following = act(policy, taken.following, self.rngs[run])
        yield taken, following, True

    def reorder(self, vectors: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n"]:
        """As they are."""
        return vectors
