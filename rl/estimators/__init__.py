"""Estimators of average rewards and their policy gradients, all reward channels at once."""

from .exact_gradient import ExactGradient, FiniteMDP
from .gpomdp import GPOMDP
from .interface import Estimate, Estimation, GradientEstimator

__all__ = ["GPOMDP", "Estimate", "Estimation", "ExactGradient", "FiniteMDP", "GradientEstimator"]
