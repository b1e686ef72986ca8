"""What a published method is: a direction solver, and a declaration of what it solves and which laws it breaks."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ..arrays import Jacobian, Vector
from ..direction import Direction
from ..problem import DirectionProblem
from ..settings import CheckedSettings
from ..solvers.interface import unsupported
from .function_solver import claimed_direction, require_finite


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


@dataclass(frozen=True, kw_only=True)
class PublishedMethod(CheckedSettings):
    """A direction solver that declares what it is. tolerance: the worst KKT residual that its claims may have."""

    tolerance: float = 1e-6
    declaration: ClassVar[Declaration]

    def solve(self, problem: DirectionProblem) -> Direction:
        """The method's direction; UNSUPPORTED where it says nothing about the problem."""
        return self.answer(problem) if self.supports(problem) else unsupported(problem)

    def supports(self, problem: DirectionProblem) -> bool:
        """Whether the method says anything about the problem: J d ≥ 0, unless another method says otherwise."""
        return is_cone(problem)

    def answer(self, problem: DirectionProblem) -> Direction:
        """The direction for a problem that it supports."""
        raise NotImplementedError


class TaskMethod(PublishedMethod):
    """A method to which objective and constraints are tasks alike, g₀ = g and gᵢ = Jᵢ."""

    def answer(self, problem: DirectionProblem) -> Direction:
        """`combine` of all tasks, claimed to be OPTIMAL."""
        tasks = np.vstack(gradients_of(problem))
        return claimed_direction(problem, self.combine(tasks), self.tolerance)

    def combine(self, tasks: Jacobian) -> Vector:
        """The direction of k tasks, (k, n) → (n,), the objective first."""
        raise NotImplementedError


def is_cone(problem: DirectionProblem) -> bool:
    """J d ≥ 0, rows with the bound −inf apart; no metric, no radius."""
    if problem.metric is not None or problem.radius is not None:
        return False
    return bool(not problem.equality.any() and ((problem.bound == 0.0) | (problem.bound == -np.inf)).all())


def gradients_of(problem: DirectionProblem) -> tuple[Vector, Jacobian]:
    """g and the rows of J that are switched on; ValueError unless finite."""
    require_finite(problem)
    return problem.gradient, problem.jacobian[problem.bound > -np.inf]
