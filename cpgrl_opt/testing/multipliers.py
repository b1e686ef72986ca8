"""When two answers must have the same multipliers, and within what."""

import numpy as np

from ..problem import DirectionProblem
from ..projection import RANK_TOLERANCE
from ..published.euclidean import euclidean
from ..scaling import unit_rows
from ..solvers.facts import tolerance_of
from ..solvers.interface import DirectionSolver
from .law import Answer, length, require_at_most, whitened


def require_same_multipliers(
    solver: DirectionSolver, problem: DirectionProblem, answers: tuple[Answer, Answer], apart: float, when: str
) -> None:
    """LawError unless ‖Δμ̂‖ ≤ (`apart` + 2(1 + m)εσ)/σ_min(Ĵ) on the rows that are on, ‖Δd‖ being ≤ `apart`.

    Each μ solves Jᵀμ = d − g to εσ, and is at most εσ on a row that is off. Nothing is asked where the rows that are on
    depend, for then μ is not unique, or where there is a radius, since forces have a unit of their own there.
    """
    on = problem.bound > -np.inf
    if problem.radius is not None or not on.any() or on.sum() > problem.n:
        return
    rows = unit_rows(euclidean(problem).jacobian)
    smallest = float(np.linalg.svd(rows.jacobian[on], compute_uv=False)[-1])
    if smallest <= RANK_TOLERANCE:
        return
    first, second = answers
    difference = rows.times_length(first.multipliers - second.multipliers)[on]
    sigma = max(length(euclidean(problem).gradient), *(length(whitened(problem, each.value)) for each in answers))
    require_at_most(
        length(difference),
        (apart + 2 * (1 + problem.m) * tolerance_of(solver) * sigma) / smallest,
        f"‖Δμ̂‖ {when}",
        "The rows are independent, so the multipliers are unique: return them in the order of the rows, d = g + Jᵀμ.",
        problem,
        first,
        second,
    )
