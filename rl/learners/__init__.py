"""Learners: each maps a linearization to a parameter change."""

from .constraint_switching import ConstraintSwitching
from .cpgrl import CPGRL
from .gradient_with_restoration import GradientWithRestoration
from .interface import Learner, LearnerUpdate
from .weighted_sum import WeightedSum

__all__ = ["CPGRL", "ConstraintSwitching", "GradientWithRestoration", "Learner", "LearnerUpdate", "WeightedSum"]
