"""The paper's second experiment (§4): CPGRL on the two-link arm, with and without constraints."""

from .experiment import ArmExperiment as ArmExperiment
from .experiment import arm_policy as arm_policy
