"""What a published method is: a direction solver, and a declaration of what it solves and which laws it breaks."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from ..arrays import Jacobian, Vector
from ..direction import Direction
from ..problem import DirectionProblem
from .function_solver import require_finite


@dataclass(frozen=True)
class Declaration:
    """name: as published; formula, problem, source: one line each; problem: which of ours it solves, if any.

    broken: check of the kit → why the method breaks it. All other laws that say something about it hold.
    """

    name: str
    formula: str
    source: str
    problem: str
    broken: Mapping[str, str] = field(default_factory=dict)


@runtime_checkable
class PublishedMethod(Protocol):
    """A direction solver that declares what it is."""

    @property
    def declaration(self) -> Declaration:
        """What the method is, solves and breaks."""

    def supports(self, problem: DirectionProblem) -> bool:
        """Whether the method says anything about the problem."""

    def solve(self, problem: DirectionProblem) -> Direction:
        """The method's direction."""


def is_cone(problem: DirectionProblem) -> bool:
    """J d ≥ 0, rows with the bound −inf apart; no metric, no radius."""
    if problem.metric is not None or problem.radius is not None:
        return False
    return bool(not problem.equality.any() and ((problem.bound == 0.0) | (problem.bound == -np.inf)).all())


def gradients_of(problem: DirectionProblem) -> tuple[Vector, Jacobian]:
    """g and the rows of J that are switched on; ValueError unless finite."""
    require_finite(problem)
    return problem.gradient, problem.jacobian[problem.bound > -np.inf]


def stacked_gradients(problem: DirectionProblem) -> Jacobian:
    """The gradients of all tasks, the objective first: (1 + k, n). ValueError unless finite."""
    gradient, rows = gradients_of(problem)
    return np.vstack([gradient, rows])
