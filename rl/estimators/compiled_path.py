"""Which environments and policies compiled estimators stand for; the others go the generic path.

Whoever has code of its own, an environment (`envs.interface.finite_kernel_of`) or a policy, is trained by that code.
Raises ValueError for an environment that its kernels do not stand for and that has no `reset` and `step`.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..policies import LinearSoftmax, NormalizedGaussianNetwork, Policy, SoftmaxTable
from ..spaces import behaves_as

if TYPE_CHECKING:
    from envs.interface import ContinuousKernels, FiniteKernel


def finite_kernel_for(environment: Any, policy: Policy) -> "FiniteKernel | None":
    """A finite MDP's kernel, where the policy is a plain `SoftmaxTable`."""
    from envs.interface import finite_kernel_of  # Gymnasium loads with envs

    return finite_kernel_of(environment) if behaves_as(policy, SoftmaxTable) else None


def continuous_kernels_for(environment: Any, policy: Policy) -> "ContinuousKernels | None":
    """A `ContinuousEnvironment`'s kernels, where the policy is a plain `NormalizedGaussianNetwork`."""
    from envs.interface import continuous_kernels_of  # Gymnasium loads with envs

    return continuous_kernels_of(environment) if behaves_as(policy, NormalizedGaussianNetwork) else None


def require_one_class(environment: Any, policy: Policy, average: str | Sequence[str]) -> None:
    """ValueError where an average per step is asked for that depends on which of several classes a run is caught in.

    As `ExactGradient` and the linear programme refuse it; seen where the environment is a finite MDP and the policy
    takes every action. The sum over an episode of limited length is well defined all the same.
    """
    from gymnasium import wrappers

    from envs.interface import finite_kernel_of  # Gymnasium loads with envs

    while type(environment) in (wrappers.TimeLimit, wrappers.OrderEnforcing, wrappers.PassiveEnvChecker):
        environment = environment.env  # the chain is that of what gymnasium.make put in them
    kinds = (average,) if isinstance(average, str) else average
    takes_all = behaves_as(policy, SoftmaxTable) or behaves_as(policy, LinearSoftmax)
    kernel = finite_kernel_of(environment) if takes_all and "step" in kinds else None
    if kernel is None:
        return
    try:
        kernel.require_one_class()
    except ValueError as error:
        raise ValueError(f'{error}. The sum over an episode does not: average="episode"') from error
