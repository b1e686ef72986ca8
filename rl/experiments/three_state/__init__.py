"""The paper's first experiment (§3): CPGRL, CONB and SUM on the three-state MDP, beside exact averages."""

from .experiment import METHODS as METHODS
from .experiment import ThreeStateExperiment as ThreeStateExperiment
