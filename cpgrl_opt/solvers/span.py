"""Long vectors: a problem of many parameters solved in the 1 + m coordinates of its own gradients, by any solver.

The usual problem takes few calls: μ from the Gramian, one pass that combines the vectors, and its judgement. Else each
rung of `reduction` is tried in turn, and what it gives is judged on the vectors themselves. What no rung answers is
solved on the rows as they are.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from ..arrays import Bool, Float, Int, Multipliers
from ..certify import certified_residuals, kkt_residuals
from ..compensated import Pair
from ..direction import Direction, KKTResiduals, Status
from ..problem import DirectionProblem, convert_answer, nothing
from ..reduction import EXACT, GATES, OUT_OF_SPAN, RUNGS, Coordinates, coordinates
from ..scaling import lengths
from ..vectors import REPRESENTABLE, Vectors, is_long
from .compiled._gramian_core import judge, weigh

_SETTLED = (Status.INFEASIBLE, Status.UNSUPPORTED)  # no better rung says otherwise
# What may be left of what depends, where K in float64 has to tell (see `reduction`): as little as in pairs. With 1e-9
# rows 1e-12 rad from opposing would be met within the tolerance by directions half as long as the right one away.
_CANCELLED = 1e-13


def solve_in_span(
    solve: Callable[[DirectionProblem], Direction], problem: DirectionProblem, tolerance: float, is_exact: bool = False
) -> Direction:
    """The problem in coordinates, by `solve`; mapped back, and certified at the tolerance. M = I.

    To be called by the vectors' `attempt`. solve: of short problems, and of long ones as a last resort. is_exact: it is
    the exact core and there is no ball: then the usual problem needs no coordinates.
    """
    vectors, left = problem.vectors, None
    if not (problem.is_tree and vectors.has_rows and not is_long(*vectors.shape)):  # a short tree is a short problem
        usual = solve_by_gramian(problem, vectors, tolerance) if is_exact and "gramian" in RUNGS else None
        if usual is not None:
            return usual
        for found in _solve_by_rungs(solve, problem, tolerance):
            if found.status != Status.UNCERTIFIED:
                return found
            left = found
    if not vectors.has_rows:
        return left or nothing(problem, Status.UNCERTIFIED)
    g, J = np.ascontiguousarray(problem.gradient), np.ascontiguousarray(problem.jacobian)
    whole = DirectionProblem.trusted(g, J, problem.bound, problem.equality, problem.radius)
    return convert_answer(problem, solve(whole), rung="rows")


def solve_by_gramian(problem: DirectionProblem, vectors: Vectors, tolerance: float) -> Direction | None:
    """The certified direction; None where the problem is not usual. M = I, no radius.

    What is usual: the gates of rung "gramian" are open, the direct pass finds the active set, and the certificate is
    within 1e-12. `coordinates` sees the same Gramian and takes the same gates.
    """
    found = weigh_problems(vectors.gramian()[None], problem.bound[None], problem.equality[None])
    if found.changes[0] < 0:
        return None
    weights = found.weights[0]
    value, sums = vectors.combine_usually(weights)
    parts = found.judge(sums[None])[0].tolist()
    if not max(parts) <= min(tolerance, EXACT) or (problem.is_tree and not sums[-1] <= REPRESENTABLE):
        return None
    residuals = tuple.__new__(KKTResiduals, parts)  # as in `exact_core`
    return Direction.make(value, weights[1:], Status.OPTIMAL, int(found.changes[0]), residuals, "gramian")


@dataclass(frozen=True, eq=False)
class Weighed:
    """B problems by their Gramians: weights (B, 1 + m) of g and the rows, and exchanges, (B,), −1 where it is open."""

    gramians: Float[np.ndarray, "B channels channels"]
    equality: Bool[np.ndarray, "B m"]
    weights: Float[np.ndarray, "B channels"]
    changes: Int[np.ndarray, "B"]
    notes: tuple[np.ndarray, np.ndarray]

    def judge(self, sums: Float[np.ndarray, "B sums"]) -> Float[np.ndarray, "B 4"]:
        """Residuals of what the weights combine, from its sums; the first is infinite where they are not to trust."""
        parts = np.empty((len(sums), 4))
        judge.run(self.gramians, self.equality, OUT_OF_SPAN, *self.notes, sums, parts)
        return parts


def weigh_problems(
    gramians: Float[np.ndarray, "B channels channels"],
    bound: Float[np.ndarray, "B m"],
    equality: Bool[np.ndarray, "B m"],
) -> Weighed:
    """One compiled call for all; see `solve_by_gramian`."""
    count, m = bound.shape
    notes = np.empty((count, 8, m)), np.empty((count, m), np.int64)
    weights, changes = np.empty((count, 1 + m)), np.empty(count, np.int64)
    weigh.run(gramians, bound, equality, *GATES, *notes, weights, changes)
    return Weighed(gramians, equality, weights, changes, notes)


def _solve_by_rungs(
    solve: Callable[[DirectionProblem], Direction], problem: DirectionProblem, tolerance: float
) -> Iterator[Direction]:
    """What each rung that is exact enough says; UNCERTIFIED where the vectors' own d does not hold it."""
    vectors, on = problem.vectors, problem.bound > -inf
    for rung in RUNGS:
        small = coordinates(vectors, on, rung)
        if small is None:
            continue
        is_rough = rung != RUNGS[0] and not vectors.has_pairs
        given = small.gradient, small.jacobian, problem.bound, problem.equality
        reduced = DirectionProblem.trusted(*given, problem.radius)
        found = replace(solve(reduced), rung=RUNGS[0] if is_rough else rung)
        if found.status == Status.OPTIMAL:
            yield from _certify(problem, small, reduced, found, min(tolerance, _CANCELLED) if is_rough else tolerance)
        elif found.status in _SETTLED:
            value, certificate = vectors.combine(small.weights(found.value), found.multipliers)
            unit = max(float(lengths(found.value)), float(small.lengths[0])) or 1.0
            holds = small.holds(found.value, certificate, unit)
            if holds and not (is_rough and not _cancels(problem, small, found.multipliers)):
                yield replace(found, value=value)


def _certify(
    problem: DirectionProblem, small: Coordinates, reduced: DirectionProblem, found: Direction, tolerance: float
) -> Iterator[Direction]:
    """The optimum of the coordinates brought back to the vectors, each way, OPTIMAL where they say so too."""
    kappa = 1.0 if problem.radius is None else found.radius_multiplier
    for weights, multipliers in _recoveries(small, problem, found):
        value, certificate = problem.vectors.combine(weights, multipliers, kappa)
        residuals = certified_residuals(certificate, problem, multipliers, small.lengths, kappa)
        worst = residuals.worst
        if certificate.length**2 > REPRESENTABLE and not problem.is_representable(value):
            continue
        claim = replace(found, value=value, multipliers=multipliers, residuals=residuals)
        if worst <= tolerance and (worst <= EXACT or worst - EXACT <= kkt_residuals(reduced, found).worst):
            yield claim
        else:
            yield replace(claim, status=Status.UNCERTIFIED, residuals=None)


def _cancels(problem: DirectionProblem, small: Coordinates, y: Multipliers) -> bool:
    """Whether Jᵀy = 0 up to rounding, measured as it is formed: of rows that count as dependent K does not tell."""
    length = problem.vectors.combine(Pair(np.append(0.0, y), np.zeros(1 + problem.m)), y)[1].length
    return bool(length <= _CANCELLED * (np.abs(y) @ small.lengths[1:]))


def _recoveries(small: Coordinates, problem: DirectionProblem, found: Direction) -> Iterator[tuple[Pair, Multipliers]]:
    """Weights and multipliers: refined on the face that the answer names (pairs only), then as they are."""
    if small.rung == RUNGS[-1] and problem.radius is None:  # in a ball the face alone does not say where d ends
        weights = small.refine(found.multipliers, problem.bound)
        yield weights, weights.hi[1:]
    yield small.weights(found.value), found.multipliers
