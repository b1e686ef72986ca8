"""Exact average rewards and policy gradients of a finite MDP, in place of estimates."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from cpgrl_opt.arrays import Float

from .._spaces import behaves_as
from ..policies import Policy, SoftmaxTable
from .interface import Estimate


@runtime_checkable
class FiniteMDP(Protocol):
    """A finite MDP that knows its own averages and gradients; a policy is a table (S, A)."""

    def average_rewards(self, policy: Any) -> Any:
        """gⁱ, (1 + m,)."""

    def policy_gradients(self, policy: Any) -> Any:
        """∂gⁱ/∂θ_{s,a} for softmax parameters, (1 + m, S, A)."""


@dataclass(frozen=True)
class ExactGradient:
    """ρⁱ = gⁱ(θ), Δⁱ = ∇gⁱ(θ), no sampling: what GPOMDP and others estimate.

    For an environment that is a `FiniteMDP`, and a `SoftmaxTable`. With it the paper's termination, PΔ¹ = 0 and no
    positive λ, can come true: the learner reports it as `stationary`.
    """

    def start(self, environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence]) -> "ExactEstimation":
        """As many runs as streams; nothing is drawn from them.

        Raises
        ------
        ValueError
            For what is no finite MDP or no `SoftmaxTable`; for a subclass with dynamics of its own and no answers.
        """
        if not isinstance(environment, FiniteMDP):
            raise ValueError(
                "environment should have average_rewards and policy_gradients, as a finite MDP; "
                f"found {type(environment).__name__}"
            )
        _require_own_answers(environment)
        if not behaves_as(policy, SoftmaxTable):
            raise ValueError(f"policy should be a SoftmaxTable with no code of its own; found {type(policy).__name__}")
        return ExactEstimation(environment, policy, len(streams))


def _require_own_answers(environment: FiniteMDP) -> None:
    """ValueError where a subclass changes the dynamics, for which the answers that it inherits no longer hold."""
    from envs.interface import declaring_class, list_overrides

    owner = declaring_class(environment, "policy_gradients")
    if owner and (changed := list_overrides(environment, owner, ("reset", "step", "finite_kernel"))):
        raise ValueError(
            f"{type(environment).__name__} should declare its own average_rewards and policy_gradients, since it has "
            f"its own {', '.join(changed)}; found only those that it inherits from {owner.__name__}"
        )


class ExactEstimation:
    """Runs at their θ; nothing is carried over."""

    carried = ()

    def __init__(self, mdp: FiniteMDP, policy: SoftmaxTable, runs: int) -> None:
        self.mdp = mdp
        self.policy = policy
        self.runs = runs

    def episode(self, parameters: Float[np.ndarray, "B n"]) -> Estimate:
        """g and ∇g at each row of `parameters`; one by one, so that a run is the same in any batch."""
        tables = self.policy.probabilities(parameters)
        values = np.array([self.mdp.average_rewards(table) for table in tables], dtype=np.float64)
        gradients = np.array([self.mdp.policy_gradients(table) for table in tables], dtype=np.float64)
        steps, events = np.zeros((2, self.runs), dtype=np.int64)
        return Estimate(values, gradients.reshape((*values.shape, -1)), steps, np.zeros_like(values), events)
