"""What stands before and behind every QP back end, so that a back end is one small function.

Before: rows that are zero, switched off or too slack to matter are taken out; unit rows; everything in units of
s = max(‖g‖, (b̂ᵢ)₊ on I, |b̂ᵢ| on E); at most m + 1 coordinates (see `reduction`). Behind: the answer is mapped back,
polished once on its face (see `polishing`), and judged by the referee. Only an answer that `kkt_residuals` puts
within the tolerance is OPTIMAL; only a proven Farkas vector makes INFEASIBLE (see `infeasibility`).
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import Multipliers, Vector
from ..certify import KKTResiduals, kkt_residuals
from ..direction import Direction, Status
from ..problem import DirectionProblem
from .infeasibility import infeasible_direction, misses_a_bound
from .kernels import compiled_kernels, solve_single
from .polishing import polished
from .reduction import BackEnd, BackEndAnswer, ScaledProblem, reduce_problem, scale_problem

# A polished answer is this good; there is nothing to gain from comparing it with the back end's own.
_EXACT = 1e-13
_SHARP = 1e-9  # worst residual of the projection onto a face, which is judged anew
# Feasible problems are met to rounding after polishing; a certified answer that is not may be weakly infeasible.
_SUSPICIOUS_VIOLATION = 1e-10
# In units of s: tried where the first attempt fails on a feasible problem.
_LARGER_UNITS = (1e3, 1e6)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A direction with multipliers in the problem's own units, and what the referee says of it."""

    value: Vector
    multipliers: Multipliers
    residuals: KKTResiduals

    def claimed(self, status: Status, iterations: int = 0) -> Direction:
        """The candidate as an answer."""
        return Direction(self.value, self.multipliers, status, iterations)


@dataclass(frozen=True, eq=False)
class Attempt:
    """What came of one call of a back end: its answer, and the best candidate made of it (None without a point)."""

    answer: BackEndAnswer
    candidate: Candidate | None

    @property
    def worst(self) -> float:
        """The candidate's worst residual."""
        return np.inf if self.candidate is None else self.candidate.residuals.worst


def solve_prepared(problem: DirectionProblem, back_end: BackEnd, *, tolerance: float, polish: bool = True) -> Direction:
    """The direction that `back_end` finds behind the shared preparation, with an honest status."""
    scaled = scale_problem(problem)
    screened = screen(scaled)
    if screened is not None:
        return screened
    attempt = _attempt(scaled, back_end, polish)
    infeasible = _infeasible(problem, attempt, tolerance)
    if infeasible is not None:
        return infeasible
    for factor in _larger_units(scaled):
        if attempt.worst <= tolerance:
            break
        attempt = min(attempt, _attempt(scaled.rescaled(factor), back_end, polish), key=lambda each: each.worst)
    return _claimed(problem, attempt, tolerance)


def judged(problem: DirectionProblem, candidate: Candidate, tolerance: float, iterations: int) -> Direction:
    """OPTIMAL within the tolerance, INFEASIBLE where that is proven, else UNCERTIFIED."""
    attempt = Attempt(BackEndAnswer(None, None, iterations), sharpened(problem, candidate))
    return _infeasible(problem, attempt, tolerance) or _claimed(problem, attempt, tolerance)


def sharpened(problem: DirectionProblem, candidate: Candidate) -> Candidate:
    """The candidate, or the projection onto its face by the exact core, whichever is better.

    Unit rows are rounded, which tilts rows at an angle θ by eps/θ, and d with them; the core looks at rows as given.
    """
    if candidate.residuals.worst <= _EXACT:
        return candidate
    held = problem.equality | (candidate.multipliers != 0.0)
    bound = np.where(held, problem.bound, -np.inf)
    if (held & (bound == -np.inf)).any():
        return candidate
    face = DirectionProblem.trusted(problem.gradient, problem.jacobian, bound, held)
    found = solve_single(compiled_kernels().solve_tangent, face, _SHARP)
    if found.status != Status.OPTIMAL:
        return candidate
    others = []
    for multipliers in (found.multipliers, candidate.multipliers):  # of dependent rows these have the right signs
        claim = Direction(found.value, multipliers, Status.UNCERTIFIED)
        others.append(Candidate(found.value, multipliers, kkt_residuals(problem, claim)))
    return min(candidate, *others, key=lambda each: each.residuals.worst)


def failure(problem: DirectionProblem, status: Status, iterations: int = 0) -> Direction:
    """Zeros, for NUMERICAL_ERROR and UNSUPPORTED."""
    return Direction(np.zeros(problem.n), np.zeros(problem.m), status, iterations)


def require_session_shape(problem: DirectionProblem, n: int, m: int) -> None:
    """ValueError unless the problem has the shape that a session was opened for."""
    if (problem.m, problem.n) != (m, n):
        raise ValueError(
            f"problem should have m = {m} and n = {n} as its session; found m = {problem.m}, n = {problem.n}"
        )


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


def _attempt(scaled: ScaledProblem, back_end: BackEnd, polish: bool) -> Attempt:
    """One call of the back end; of its own and the polished answers the one that the referee likes best."""
    scaled, answer, d, multipliers = _solve_relevant_rows(scaled, back_end)
    if not answer.is_usable:
        return Attempt(answer, None)
    candidates: list[Candidate] = []
    for point, weights in polished(scaled, d, multipliers) if polish else ():
        candidates.append(sharpened(scaled.problem, candidate_of(scaled, point, weights)))
        if candidates[-1].residuals.worst <= _EXACT:
            return Attempt(answer, candidates[-1])
    candidates.append(candidate_of(scaled, d, multipliers))
    return Attempt(answer, min(candidates, key=lambda candidate: candidate.residuals.worst))


def _larger_units(scaled: ScaledProblem) -> tuple[float, ...]:
    """Rows that oppose each other and ask for something push d far beyond s, out of a back end's sight."""
    asks = np.where(scaled.equality, scaled.bound != 0.0, scaled.bound > 0.0)
    return _LARGER_UNITS if asks.any() else ()


def _infeasible(problem: DirectionProblem, attempt: Attempt, tolerance: float) -> Direction | None:
    """The proof of infeasibility, looked for where an answer is rejected or violates more than rounding does."""
    candidate, certified = attempt.candidate, attempt.worst <= tolerance
    is_met = candidate is not None and candidate.residuals.primal <= _SUSPICIOUS_VIOLATION
    if certified and is_met and not misses_a_bound(problem, candidate.value):  # type: ignore[union-attr]
        return None
    return infeasible_direction(problem, attempt.answer.iterations)


def _claimed(problem: DirectionProblem, attempt: Attempt, tolerance: float) -> Direction:
    """OPTIMAL within the tolerance, else what the back end says of its failure."""
    answer, candidate = attempt.answer, attempt.candidate
    if candidate is not None and attempt.worst <= tolerance:
        return candidate.claimed(Status.OPTIMAL, answer.iterations)
    is_limit = answer.failure == Status.ITERATION_LIMIT
    gave_up = answer.failure in (Status.INFEASIBLE, Status.NUMERICAL_ERROR)  # its point is no attempt at the optimum
    if candidate is None or gave_up or not np.isfinite(attempt.worst):
        return failure(problem, Status.ITERATION_LIMIT if is_limit else Status.NUMERICAL_ERROR, answer.iterations)
    return candidate.claimed(Status.ITERATION_LIMIT if is_limit else Status.UNCERTIFIED, answer.iterations)
