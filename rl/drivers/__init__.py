"""What plays episodes, one file for each kind of environment; every update rule runs with every driver."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._spaces import behaves_as
from ..policies import NormalizedGaussianNetwork, Policy, SoftmaxTable
from .interface import Batch, Course, Driver, Rule, RuleStep, Score, account, close_run, compiled_step, open_run
from .python import PythonDriver

__all__ = [
    "Batch", "Course", "Driver", "PythonDriver", "Rule", "RuleStep", "Score", "account", "close_run",
    "compiled_step", "driver_for", "open_run",
]  # fmt: skip


def driver_for(environment: Any, policy: Policy, streams: Sequence[np.random.SeedSequence], steps: int) -> Driver:
    """The first driver that takes environment and policy.

    Whoever has code of its own, an environment or a policy, is trained by that code, in Python.

    Parameters
    ----------
    streams
        One for each run.
    steps
        The time limit of an episode, where the environment has no shorter one.

    Raises
    ------
    ValueError
        For an environment that its kernels do not stand for and that has no `reset` and `step`; for a policy that does
        not fit it.
    """
    from envs.interface import continuous_kernels_of, finite_kernel_of  # Gymnasium loads with envs

    if behaves_as(policy, SoftmaxTable) and (mdp := finite_kernel_of(environment)) is not None:
        from .finite import FiniteDriver  # numba loads here

        return FiniteDriver(mdp, policy, streams, steps)
    if behaves_as(policy, NormalizedGaussianNetwork) and (kernels := continuous_kernels_of(environment)) is not None:
        from .continuous import ContinuousDriver  # and here

        return ContinuousDriver(kernels, policy, streams, steps)
    return PythonDriver(environment, policy, streams, steps)
