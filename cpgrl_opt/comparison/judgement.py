"""What an answer is worth: the outcome of one solver on one problem, judged from the problem's data alone."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Vector
from ..certify import excess_violation, farkas_residual, kkt_residuals
from ..direction import Direction, Status
from ..exact import ExactAnswer
from ..problem import DirectionProblem
from ..scaling import lengths
from .measurement import PROOF_TOLERANCE, SUCCESS_TOLERANCE, WRONG_TOLERANCE


@dataclass(frozen=True)
class Judgement:
    """outcome: one of OUTCOMES; status: the name of what was claimed; worst, distance: as in Measurement."""

    outcome: str
    status: str
    worst: float
    distance: float | None = None


HUNG = Judgement("hang", "", float("inf"))
CRASHED = Judgement("crash", "", float("inf"))
UNSUPPORTED = Judgement("unsupported", Status.UNSUPPORTED.name, float("inf"))


def judge(
    problem: DirectionProblem,
    direction: Direction,
    *,
    feasible: bool,
    exact: ExactAnswer | None = None,
    verdict_only: bool = False,
) -> Judgement:
    """The outcome, as `measurement` defines it.

    A right INFEASIBLE whose multipliers prove nothing, or whose direction does not violate least, is inaccurate: the
    verdict is right, and must be believed. verdict_only: of a library alone nobody expects that direction.
    exact: the exact answer, for the distance of what is claimed optimal; None where it is unknown.
    """
    status = direction.status
    if status == Status.UNSUPPORTED:
        return UNSUPPORTED
    if status == Status.INFEASIBLE:
        if feasible:
            return Judgement("false-infeasible", status.name, float("inf"))
        residual = farkas_residual(problem, direction.multipliers)
        is_proven = residual <= PROOF_TOLERANCE
        is_least = verdict_only or excess_violation(problem, direction.value) <= SUCCESS_TOLERANCE
        return Judgement("success" if is_proven and is_least else "inaccurate", status.name, residual)
    worst = kkt_residuals(problem, direction).worst
    if status != Status.OPTIMAL:
        return Judgement("honest-failure", status.name, worst)
    if not feasible:
        return Judgement("missed-infeasible", status.name, worst)
    distance = None if exact is None else _distance(problem, direction, exact)
    return Judgement(_claim_of_optimality(worst), status.name, worst, distance)


def _claim_of_optimality(worst: float) -> str:
    if worst <= SUCCESS_TOLERANCE:
        return "success"
    return "inaccurate" if worst <= WRONG_TOLERANCE else "silently-wrong"


def _distance(problem: DirectionProblem, direction: Direction, exact: ExactAnswer) -> float | None:
    """‖d − d*‖ / max(‖g‖, ‖d*‖), absolute where both vanish; None where d is not finite.

    In a metric all three where M = I; in a ball, where g is no length, over the radius.
    """
    if not np.isfinite(direction.value).all():
        return None
    apart = direction.value - exact.direction
    if problem.radius is not None:
        return _length(problem, apart / problem.radius)
    strength = problem.gradient if problem.whitening is None else problem.whitening.rows(problem.gradient)
    size = max(float(lengths(strength)), _length(problem, exact.direction)) or 1.0
    return _length(problem, direction.value / size - exact.direction / size)


def _length(problem: DirectionProblem, d: Vector) -> float:
    """√(dᵀMd)."""
    return float(lengths(d if problem.whitening is None else problem.whitening.direction(d)))
