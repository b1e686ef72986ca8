"""Constrained policy-gradient reinforcement learning: policies, gradient estimators, learners, training.

>>> from cpgrl_opt import ConstrainedStep
>>> from envs import ThreeStateMDP
>>> from rl import CPGRL, GPOMDP, SoftmaxTable, train
>>> learner = CPGRL(ConstrainedStep(solver="rosen"), thresholds=[0, 0, 0])
>>> for record in train(ThreeStateMDP(), SoftmaxTable(3, 3), GPOMDP(), learner, episodes=10, runs=2):
...     pass
>>> record.episode, record.parameters.shape
(10, (2, 9))
"""

from . import _own_packages as _own_packages
from .estimators import GPOMDP, Estimate, Estimation, ExactGradient, GradientEstimator, KondaActorCritic
from .learners import CPGRL, ConstraintSwitching, GradientWithRestoration, Learner, LearnerUpdate, WeightedSum
from .parallel import map_runs
from .policies import LinearGaussian, LinearSoftmax, NormalizedGaussianNetwork, Policy, SoftmaxTable
from .rollout import RolloutError
from .sweeps import Sweep, sweep
from .training import DivergenceError, Training, TrainingRecord, train, uniform_parameters

__all__ = [
    "CPGRL", "GPOMDP", "ConstraintSwitching", "DivergenceError", "Estimate", "Estimation", "ExactGradient",
    "GradientEstimator", "GradientWithRestoration", "KondaActorCritic", "Learner", "LearnerUpdate",
    "LinearGaussian", "LinearSoftmax", "NormalizedGaussianNetwork", "Policy", "RolloutError", "SoftmaxTable",
    "Sweep", "Training", "TrainingRecord", "WeightedSum", "map_runs", "sweep", "train", "uniform_parameters",
]  # fmt: skip
