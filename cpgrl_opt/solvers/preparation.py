"""What stands before and behind every QP back end, so that a back end is one small function.

Before: rows that are zero, switched off or too slack to matter are taken out; unit rows; everything in units of
s = max(‖g‖, (b̂ᵢ)₊ on I, |b̂ᵢ| on E); at most m + 1 coordinates (see `reduction`). Behind: the answer is mapped back,
polished once on its face (see `polishing`), and judged by the referee. Only an answer that `kkt_residuals` puts
within the tolerance is OPTIMAL; only a proven Farkas vector makes INFEASIBLE (see `infeasibility`).
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import Multipliers, Vector
from ..direction import Direction, Status
from ..kkt import KKTResiduals, kkt_residuals
from ..problem import DirectionProblem
from .infeasibility import infeasible_direction
from .polishing import faces, project_onto_face
from .reduction import BackEnd, BackEndAnswer, ScaledProblem, reduce_problem, scale_problem

# A polished answer is this good; there is nothing to gain from comparing it with the back end's own.
_EXACT = 1e-13
# Feasible problems are met to rounding after polishing; a certified answer that is not may be weakly infeasible.
_SUSPICIOUS_VIOLATION = 1e-10


@dataclass(frozen=True, eq=False)
class Candidate:
    """A direction with multipliers in the problem's own units, and what the referee says of it."""

    value: Vector
    multipliers: Multipliers
    residuals: KKTResiduals

    def claimed(self, status: Status, iterations: int = 0) -> Direction:
        """The candidate as an answer."""
        return Direction(self.value, self.multipliers, status, iterations)


def solve_prepared(problem: DirectionProblem, back_end: BackEnd, *, tolerance: float, polish: bool = True) -> Direction:
    """The direction that `back_end` finds behind the shared preparation, with an honest status."""
    scaled = scale_problem(problem)
    screened = screen(scaled)
    if screened is not None:
        return screened
    scaled, answer, d, multipliers = _solve_relevant_rows(scaled, back_end)
    if not answer.is_usable:
        return infeasible_direction(problem, answer.iterations) or _without_answer(problem, answer)
    best = _best_candidate(scaled, d, multipliers, tolerance if polish else None)
    return judged(problem, best, answer, tolerance)


def judged(problem: DirectionProblem, candidate: Candidate, answer: BackEndAnswer, tolerance: float) -> Direction:
    """OPTIMAL within the tolerance, INFEASIBLE where that is proven, else the back end's failure or UNCERTIFIED."""
    certified = candidate.residuals.worst <= tolerance
    if not certified or candidate.residuals.primal > _SUSPICIOUS_VIOLATION:
        infeasible = infeasible_direction(problem, answer.iterations)
        if infeasible is not None:
            return infeasible
    if certified:
        return candidate.claimed(Status.OPTIMAL, answer.iterations)
    if not np.isfinite(candidate.residuals.worst) or answer.failure == Status.NUMERICAL_ERROR:
        return failure(problem, Status.NUMERICAL_ERROR, answer.iterations)
    is_limit = answer.failure == Status.ITERATION_LIMIT
    return candidate.claimed(Status.ITERATION_LIMIT if is_limit else Status.UNCERTIFIED, answer.iterations)


def failure(problem: DirectionProblem, status: Status, iterations: int = 0) -> Direction:
    """Zeros, for NUMERICAL_ERROR and UNSUPPORTED."""
    return Direction(np.zeros(problem.n), np.zeros(problem.m), status, iterations)


def candidate_of(scaled: ScaledProblem, d: Vector, multipliers: np.ndarray) -> Candidate:
    """(d, μ) in units of s, brought back to the problem's units and put before the referee."""
    with np.errstate(over="ignore", under="ignore"):
        value = d * scaled.scale
    original = scaled.original_multipliers(multipliers)
    problem = scaled.problem
    return Candidate(value, original, kkt_residuals(problem, Direction(value, original, Status.UNCERTIFIED)))


def screen(scaled: ScaledProblem) -> Direction | None:
    """The answer where no back end is needed: impossible zero rows, overflow, nothing asked, or g feasible."""
    problem = scaled.problem
    if not np.isfinite(scaled.scale):
        return failure(problem, Status.NUMERICAL_ERROR)
    if scaled.impossible.any():
        return infeasible_direction(problem) or failure(problem, Status.NUMERICAL_ERROR)
    lack = scaled.bound - scaled.rows @ scaled.gradient
    if (np.where(scaled.equality, lack == 0.0, lack <= 0.0)).all():
        return Direction(problem.gradient.copy(), np.zeros(problem.m), Status.OPTIMAL)
    return None


def _solve_relevant_rows(
    scaled: ScaledProblem, back_end: BackEnd
) -> tuple[ScaledProblem, BackEndAnswer, Vector, np.ndarray]:
    """Solve on the rows that can matter; add those that the answer violates, until there are none."""
    considered = scaled.relevant_rows()
    while True:
        reduced, basis = reduce_problem(scaled.restricted(considered))
        answer = back_end(reduced)
        multipliers = np.zeros(len(considered))
        if not answer.is_usable:
            return scaled, answer, scaled.gradient, multipliers
        d = scaled.gradient + basis @ (answer.point - reduced.center)
        multipliers[considered] = answer.multipliers
        violated = ~considered & (scaled.rows @ d < scaled.bound)
        if not violated.any():
            return scaled, answer, d, multipliers
        considered = considered | violated
        # Their bounds lie above −‖d‖, so in units of ‖d‖ all numbers are about 1 again.
        scaled = scaled.rescaled(max(1.0, float(np.sqrt(d @ d))))


def _best_candidate(scaled: ScaledProblem, d: Vector, multipliers: np.ndarray, polish_to: float | None) -> Candidate:
    """The polished answer that the referee likes best, or the back end's own where that is better."""
    candidates: list[Candidate] = []
    for face in faces(scaled, d, multipliers) if polish_to is not None else []:
        candidates.append(candidate_of(scaled, *project_onto_face(scaled, face)))
        if candidates[-1].residuals.worst <= _EXACT:
            return candidates[-1]
    candidates.append(candidate_of(scaled, d, multipliers))
    return min(candidates, key=lambda candidate: candidate.residuals.worst)


def _without_answer(problem: DirectionProblem, answer: BackEndAnswer) -> Direction:
    """Zeros with the status that fits a back end without a usable point."""
    is_limit = answer.failure == Status.ITERATION_LIMIT
    return failure(problem, Status.ITERATION_LIMIT if is_limit else Status.NUMERICAL_ERROR, answer.iterations)
