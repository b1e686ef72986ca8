"""The experiments of `cpgrl reproduce`: a line each."""

from pkgutil import resolve_name
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .experiment import Experiment

# Where the class is, by the command's name; imported when it is called.
EXPERIMENTS = {
    "three-state": "rl.experiments.three_state:ThreeStateExperiment",
    "arm": "rl.experiments.arm:ArmExperiment",
}


def experiment_named(name: str) -> "type[Experiment]":
    """The experiment's class.

    Parameters
    ----------
    name
        A key of EXPERIMENTS.

    Returns
    -------
    type of Experiment
        Imported now.
    """
    found: type[Experiment] = resolve_name(EXPERIMENTS[name])
    return found
