"""Estimators of average rewards and their policy gradients, all reward channels at once."""

from .exact_gradient import ExactGradient, FiniteMDP
from .gpomdp import GPOMDP
from .interface import Estimate, Estimation, GradientEstimator
from .konda_actor_critic import KondaActorCritic
from .sampling import Sampling, SamplingEstimator

__all__ = [
    "GPOMDP", "Estimate", "Estimation", "ExactGradient", "FiniteMDP", "GradientEstimator", "KondaActorCritic",
    "Sampling", "SamplingEstimator",
]  # fmt: skip
