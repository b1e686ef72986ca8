"""What stands before and behind every core, so that a core is one small function.

    problem ──scale, reduce──▶ SmallProblem ──core──▶ x, μ ──polish, recover──▶ d, μ ──referee──▶ Direction

Before: rows that are zero, switched off or too slack to matter are taken out (see `small_problem`). Behind: the answer
is mapped back, polished once on its face (see `polishing`), and judged by the referee. Only an answer that
`kkt_residuals` puts within the tolerance is OPTIMAL; only a proven Farkas vector makes INFEASIBLE (see
`infeasibility`).
"""

from dataclasses import replace

import numpy as np

from ..arrays import Multipliers, Vector
from ..certify import kkt_residuals, misses_a_bound
from ..direction import Direction, KKTResiduals, Status
from ..problem import DirectionProblem
from ..scaling import demand
from .exact_core import project
from .infeasibility import infeasible_direction
from .polishing import polish
from .small_problem import NEGLIGIBLE_BOUND, Core, ScaledProblem, SmallAnswer, reduce_problem, scale_problem

# A polished answer is this good; there is nothing to gain from comparing it with the core's own.
_EXACT = 1e-13
_SHARP = 1e-9  # worst residual of the projection onto a face, which is judged anew
# Feasible problems are met to rounding after polishing; a certified answer that is not may be weakly infeasible.
_SUSPICIOUS_VIOLATION = 1e-10
# In units of s: tried where the first attempt fails on a feasible problem. Rows that oppose each other and ask for
# something push d far beyond s, out of a core's sight.
_LARGER_UNITS = (1e3, 1e6)


def solve_by(core: Core, problem: DirectionProblem, *, tolerance: float, polished: bool = True) -> Direction:
    """The direction that the core finds, with an honest status. M = I, no ball."""
    arrays = problem.gradient, problem.jacobian, np.where(problem.bound == -np.inf, 0.0, problem.bound)
    if not all(np.isfinite(array).all() for array in arrays):  # only a forged problem
        return Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR)
    scaled = scale_problem(problem)
    known = _screen(scaled)
    if known is not None:
        return known
    best = _attempt(scaled, core, polished)
    is_met = best.residuals is not None and best.residuals.primal <= _SUSPICIOUS_VIOLATION
    if not (is_met and _worst(best) <= tolerance) or misses_a_bound(problem, best.value):
        impossible = infeasible_direction(problem, best.iterations)
        if impossible is not None:
            return impossible
    asks = (demand(scaled.small.bound, scaled.small.equality) > 0.0).any()
    for factor in _LARGER_UNITS if asks else ():
        if _worst(best) <= tolerance:
            break
        best = min(best, _attempt(scaled.rescale(factor), core, polished), key=_worst)
    return _claim(best, tolerance)


def _screen(scaled: ScaledProblem) -> Direction | None:
    """The answer where no core is needed: impossible zero rows, overflow, nothing asked, or g feasible."""
    problem, small = scaled.problem, scaled.small
    failed = Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR)
    if not np.isfinite(scaled.scale):
        return failed
    if scaled.impossible.any():
        return infeasible_direction(problem) or failed
    lack = small.bound - small.rows @ small.center
    if (np.where(small.equality, lack == 0.0, lack <= 0.0)).all():
        residuals = KKTResiduals(0.0, 0.0, 0.0, 0.0)
        return Direction(problem.gradient.copy(), np.zeros(problem.m), Status.OPTIMAL, residuals=residuals, rung="rows")
    return None


def _attempt(scaled: ScaledProblem, core: Core, polished: bool) -> Direction:
    """One call of the core: its answer or the polished one, whichever has the smaller residual.

    The status is how the core says that it failed, UNCERTIFIED where it does not; without a point there are zeros.
    """
    scaled, answer, d, multipliers = _solve_relevant_rows(scaled, core)
    problem, status = scaled.problem, answer.failure or Status.UNCERTIFIED
    if not answer.is_usable:
        return Direction.nothing(problem.n, problem.m, status, answer.iterations)
    found: list[Direction] = []
    for point, weights in polish(scaled.small, d, multipliers) if polished else ():
        found.append(_sharpen(problem, _recover(scaled, point, weights)))
        if _worst(found[-1]) <= _EXACT:
            break
    else:
        found.append(_recover(scaled, d, multipliers))
    return replace(min(found, key=_worst), status=status, iterations=answer.iterations)


def _solve_relevant_rows(scaled: ScaledProblem, core: Core) -> tuple[ScaledProblem, SmallAnswer, Vector, Multipliers]:
    """Solve on the rows that can matter; add those that the answer violates, until there are none."""
    considered = scaled.small.equality | (scaled.small.bound > NEGLIGIBLE_BOUND)
    while True:
        small, multipliers = scaled.small, np.zeros(len(considered))
        reduced, basis = reduce_problem(small.restrict(considered))
        answer = core(reduced)
        if not answer.is_usable:
            return scaled, answer, small.center, multipliers
        d = small.center + basis @ (answer.point - reduced.center)
        multipliers[considered] = answer.multipliers
        violated = ~considered & (small.rows @ d < small.bound)
        if not violated.any():
            return scaled, answer, d, multipliers
        considered = considered | violated
        # Their bounds lie above −‖d‖, so in units of ‖d‖ all numbers are about 1 again.
        scaled = scaled.rescale(max(1.0, float(np.sqrt(d @ d))))


def _recover(scaled: ScaledProblem, d: Vector, multipliers: Multipliers) -> Direction:
    """(d, μ) in units of s, brought back to the problem's units and put before the referee."""
    with np.errstate(over="ignore", under="ignore"):
        value = d * scaled.scale
    return _look_at(scaled.problem, value, scaled.original_multipliers(multipliers))


def _look_at(problem: DirectionProblem, value: Vector, multipliers: Multipliers) -> Direction:
    """(d, μ) with the referee's residuals."""
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
    exact = project(DirectionProblem.trusted(problem.gradient, problem.jacobian, bound, held), _SHARP, tangent=True)
    if exact.status != Status.OPTIMAL:
        return found
    # Of dependent rows the multipliers that came have the right signs.
    others = (_look_at(problem, exact.value, multipliers) for multipliers in (exact.multipliers, found.multipliers))
    return min(found, *others, key=_worst)


def _claim(best: Direction, tolerance: float) -> Direction:
    """OPTIMAL within the tolerance, else what the core says of its failure."""
    worst, is_limit = _worst(best), best.status == Status.ITERATION_LIMIT
    if worst <= tolerance:
        return replace(best, status=Status.OPTIMAL)
    if best.status in (Status.INFEASIBLE, Status.NUMERICAL_ERROR) or not np.isfinite(worst):  # no attempt at an optimum
        status = Status.ITERATION_LIMIT if is_limit else Status.NUMERICAL_ERROR
        return Direction.nothing(len(best.value), len(best.multipliers), status, best.iterations)
    return replace(best, status=Status.ITERATION_LIMIT if is_limit else Status.UNCERTIFIED, residuals=None)
