"""The experiments of `cpgrl reproduce`: a line each."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .experiment import Experiment

# Module and class by the command's name, imported when it is called.
EXPERIMENTS = {
    "three-state": ("rl.experiments.three_state", "ThreeStateExperiment"),
    "arm": ("rl.experiments.arm", "ArmExperiment"),
}


def experiment_named(name: str) -> "type[Experiment]":
    """The experiment's class."""
    module, declared = EXPERIMENTS[name]
    found: type[Experiment] = getattr(import_module(module), declared)
    return found
