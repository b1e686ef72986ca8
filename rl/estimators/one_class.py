"""Averages per step of a chain with several recurrent classes are refused: they depend on where a run is caught."""

from collections.abc import Sequence
from typing import Any

from .._spaces import behaves_as
from ..policies import LinearSoftmax, Policy, SoftmaxTable


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
