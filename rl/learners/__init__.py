"""Learners: each maps a linearization to a parameter change."""

from .constraint_switching import ConstraintSwitching
from .cpgrl import CPGRL
from .interface import Learner, LearnerUpdate
from .weighted_sum import WeightedSum

__all__ = ["CPGRL", "ConstraintSwitching", "Learner", "LearnerUpdate", "WeightedSum"]
