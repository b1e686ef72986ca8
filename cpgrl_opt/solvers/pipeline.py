"""What stands before and behind every core, so that a core is one small function.

    problem ──scale, reduce──▶ SmallProblem ──core──▶ x, μ ──polish, recover──▶ d, μ ──referee──▶ Direction

Before: rows that are zero, switched off or too slack to matter are taken out (see `small_problem`). Behind: the answer
is mapped back, polished once on its face (see `polishing`), and judged by the referee. Only an answer that
`kkt_residuals` puts within the tolerance is OPTIMAL; only a proven Farkas vector makes INFEASIBLE (see
`infeasibility`).
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Multipliers, Vector
from ..certify import kkt_residuals, misses_a_bound
from ..direction import Direction, KKTResiduals, Status
from ..problem import DirectionProblem
from ..scaling import demand
from .exact_core import project
from .infeasibility import infeasible_direction
from .polishing import polish
from .small_problem import Core, ScaledProblem, SmallAnswer, reduce_problem, scale_problem

# A polished answer is this good; there is nothing to gain from comparing it with the core's own.
_EXACT = 1e-13
_SHARP = 1e-9  # worst residual of the projection onto a face, which is judged anew
# Feasible problems are met to rounding after polishing; a certified answer that is not may be weakly infeasible.
_SUSPICIOUS_VIOLATION = 1e-10
# In units of s: tried where the first attempt fails on a feasible problem. Rows that oppose each other and ask for
# something push d far beyond s, out of a core's sight.
_LARGER_UNITS = (1e3, 1e6)


@dataclass(frozen=True, eq=False)
class _Attempt:
    """What came of one call of a core: its answer, and the best direction made of it (None without a point)."""

    answer: SmallAnswer
    best: Direction | None

    @property
    def worst(self) -> float:
        """The direction's worst residual."""
        return np.inf if self.best is None else _worst(self.best)


def solve_by(core: Core, problem: DirectionProblem, *, tolerance: float, polished: bool = True) -> Direction:
    """The direction that the core finds, with an honest status. M = I, no ball."""
    scaled = scale_problem(problem)
    screened = _screen(scaled)
    if screened is not None:
        return screened
    attempt = _attempt(scaled, core, polished)
    infeasible = _prove_infeasible(problem, attempt, tolerance)
    if infeasible is not None:
        return infeasible
    small = scaled.small
    asks = (demand(small.bound, small.equality) > 0.0).any()
    for factor in _LARGER_UNITS if asks else ():
        if attempt.worst <= tolerance:
            break
        attempt = min(attempt, _attempt(scaled.rescaled(factor), core, polished), key=lambda each: each.worst)
    return _claim(problem, attempt, tolerance)


def _screen(scaled: ScaledProblem) -> Direction | None:
    """The answer where no core is needed: impossible zero rows, overflow, nothing asked, or g feasible."""
    problem, small = scaled.problem, scaled.small
    if not np.isfinite(scaled.scale):
        return Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR)
    if scaled.impossible.any():
        return infeasible_direction(problem) or Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR)
    lack = small.bound - small.rows @ small.center
    if (np.where(small.equality, lack == 0.0, lack <= 0.0)).all():
        residuals = KKTResiduals(0.0, 0.0, 0.0, 0.0)
        return Direction(problem.gradient.copy(), np.zeros(problem.m), Status.OPTIMAL, residuals=residuals, rung="rows")
    return None


def _attempt(scaled: ScaledProblem, core: Core, polished: bool) -> _Attempt:
    """One call of the core; the raw or the polished answer, whichever has the smaller residual."""
    scaled, answer, d, multipliers = _solve_relevant_rows(scaled, core)
    if not answer.is_usable:
        return _Attempt(answer, None)
    found: list[Direction] = []
    for point, weights in polish(scaled.small, d, multipliers) if polished else ():
        found.append(_sharpen(scaled.problem, _recover(scaled, point, weights)))
        if _worst(found[-1]) <= _EXACT:
            return _Attempt(answer, found[-1])
    found.append(_recover(scaled, d, multipliers))
    return _Attempt(answer, min(found, key=_worst))


def _solve_relevant_rows(scaled: ScaledProblem, core: Core) -> tuple[ScaledProblem, SmallAnswer, Vector, np.ndarray]:
    """Solve on the rows that can matter; add those that the answer violates, until there are none."""
    considered = scaled.small.relevant_rows()
    while True:
        small = scaled.small
        reduced, basis = reduce_problem(small.restricted(considered))
        answer = core(reduced)
        multipliers = np.zeros(len(considered))
        if not answer.is_usable:
            return scaled, answer, small.center, multipliers
        d = small.center + basis @ (answer.point - reduced.center)
        multipliers[considered] = answer.multipliers
        violated = ~considered & (small.rows @ d < small.bound)
        if not violated.any():
            return scaled, answer, d, multipliers
        considered = considered | violated
        # Their bounds lie above −‖d‖, so in units of ‖d‖ all numbers are about 1 again.
        scaled = scaled.rescaled(max(1.0, float(np.sqrt(d @ d))))


def _recover(scaled: ScaledProblem, d: Vector, multipliers: np.ndarray) -> Direction:
    """(d, μ) in units of s, brought back to the problem's units and put before the referee."""
    with np.errstate(over="ignore", under="ignore"):
        value = d * scaled.scale
    return _judge(scaled.problem, value, scaled.original_multipliers(multipliers))


def _judge(problem: DirectionProblem, value: Vector, multipliers: Multipliers) -> Direction:
    found = Direction(value, multipliers, Status.UNCERTIFIED, rung="rows")
    return replace(found, residuals=kkt_residuals(problem, found))


def _worst(found: Direction) -> float:
    return np.inf if found.residuals is None else found.residuals.worst


def _sharpen(problem: DirectionProblem, found: Direction) -> Direction:
    """The direction, or the projection onto its face by the exact core, whichever has the smaller residual.

    Unit rows are rounded, which tilts rows at an angle θ by eps/θ, and d with them; the core looks at rows as given.
    """
    if _worst(found) <= _EXACT:
        return found
    held = problem.equality | (found.multipliers != 0.0)
    bound = np.where(held, problem.bound, -np.inf)
    if (held & (bound == -np.inf)).any():
        return found
    exact = project(DirectionProblem.trusted(problem.gradient, problem.jacobian, bound, held), _SHARP, tangent=True)
    if exact.status != Status.OPTIMAL:
        return found
    # Of dependent rows the multipliers that came have the right signs.
    others = (_judge(problem, exact.value, multipliers) for multipliers in (exact.multipliers, found.multipliers))
    return min(found, *others, key=_worst)


def _prove_infeasible(problem: DirectionProblem, attempt: _Attempt, tolerance: float) -> Direction | None:
    """The proof of infeasibility, looked for where an answer is rejected or violates more than rounding does."""
    best = attempt.best
    if best is not None and best.residuals is not None and attempt.worst <= tolerance:
        is_met = best.residuals.primal <= _SUSPICIOUS_VIOLATION
        if is_met and not misses_a_bound(problem, best.value):
            return None
    return infeasible_direction(problem, attempt.answer.iterations)


def _claim(problem: DirectionProblem, attempt: _Attempt, tolerance: float) -> Direction:
    """OPTIMAL within the tolerance, else what the core says of its failure."""
    answer, best = attempt.answer, attempt.best
    if best is not None and attempt.worst <= tolerance:
        return replace(best, status=Status.OPTIMAL, iterations=answer.iterations)
    is_limit = answer.failure == Status.ITERATION_LIMIT
    gave_up = answer.failure in (Status.INFEASIBLE, Status.NUMERICAL_ERROR)  # its point is no attempt at the optimum
    if best is None or gave_up or not np.isfinite(attempt.worst):
        return Direction.nothing(
            problem.n, problem.m, Status.ITERATION_LIMIT if is_limit else Status.NUMERICAL_ERROR, answer.iterations
        )
    status = Status.ITERATION_LIMIT if is_limit else Status.UNCERTIFIED
    return replace(best, status=status, iterations=answer.iterations, residuals=None)
