"""Conformance of environments and gradient estimators: plain functions that return, or say what should be.

>>> from envs import ThreeStateEnv
>>> from rl.testing import check_constrained_env
>>> check_constrained_env(ThreeStateEnv())
"""

from .contract import ContractBroken
from .environments import check_constrained_env
from .episodes import EpisodicEnv, EpisodicMDP, check_episodic_estimator
from .estimators import check_gradient_estimator

__all__ = [
    "ContractBroken", "EpisodicEnv", "EpisodicMDP", "check_constrained_env", "check_episodic_estimator",
    "check_gradient_estimator",
]  # fmt: skip
