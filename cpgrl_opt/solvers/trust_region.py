"""The ball around any core: a one-dimensional search over projections, in the few coordinates of g and the rows.

    max gᵀx  s.t.  x ∈ C = {Ax ≥ b, = on E},  ‖x‖ ≤ 1                   with  ‖g‖ = ‖Aᵢ‖ = 1

x(t) = P_C(tg), the projection that a core finds, has a length that grows with t, so x(t) with ‖x(t)‖ = 1 is the
answer, and κ = 1/t, μ = μ(t)/t. Where x(t) stops inside the ball it is the shortest of the directions that climb most,
and κ = 0. The path is piecewise straight: on the face Aᵢx = bᵢ (i ∈ 𝒜), with q its shortest point and p the part of g
along it, p ⟂ q,

    x = q + sp,   s = √(1 − ‖q‖²)/‖p‖,   κ = 1/s,   A_𝒜ᵀμ = κx − g         (p ≠ 0)
    x = q,                               κ = 0,     A_𝒜ᵀμ = −g             (p = 0)

so the search ends with the face and not with a tolerance. Whether C is empty, or beyond the ball, is asked where an
answer does not come out exact, or misses a bound, and the radius has no say in the first.
Source: Rockafellar, Convex Analysis, §28 (κ); Best 1996, the path of parametric programs.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .._violation import is_missed
from ..arrays import Bool, Float, Multipliers, Vector
from ..direction import Direction, Status
from ..flat import Flat
from ..problem import DirectionProblem, ProblemBatch
from ..scaling import demand, lengths, norm
from .ball_violation import least_violation_in_ball
from .exact_core import project, project_batch
from .infeasibility import VIOLATION_TOLERANCE, infeasible_direction
from .polishing import nonnegative_weights
from .small_problem import NEGLIGIBLE_BOUND, Core, SmallProblem, as_problem, reduce_problem

_EPS = float(np.finfo(np.float64).eps)
# An error that ends the search.
_EXACT = 1e-12
# ‖p‖/‖g‖ below this is what rounding leaves of 0.
_NEGLIGIBLE = 1e-13
# Rows this near to their bound may hold the shortest of several best points.
_NEARLY_TIGHT = 1e-9
# Of the ball's length. It, _NEARLY_TIGHT and _LARGEST_STEP a decade up or down moved no bit of 504 answers in balls.
_ROUNDING = 1e-12
# Demands in units of the radius beyond this are as far out of reach as it is; their squares would overflow.
_LARGEST_RATIO = 1e150
# A ball is tried _WIDE times as large as the largest bound first where it is _HUGE times larger still.
_HUGE, _WIDE = 1e3, 1e6
# Steps before and after the question whether anything meets the constraints, which costs more than a few of them. Half
# or twice as many moved no bit of 169 answers: the face that a step finds ends the search.
_FEW_STEPS, _MOST_STEPS = 8, 80
_LARGEST_STEP = 1e15  # of t in ‖g‖ = 1: beyond it x(t) has no digit of tg
_FARTHER = 8.0  # times t where x(t) is inside the ball and no face suggests more


@dataclass(frozen=True, eq=False)
class BallAnswer:
    """x (k,), μ (p,), κ of the module's head, and the worst residual of them; for INFEASIBLE μ is a proof y."""

    point: Vector
    multipliers: Multipliers
    kappa: float
    error: float = np.inf
    status: Status = Status.OPTIMAL
    iterations: int = 0


def solve_in_ball(core: Core, flat: Flat, contradiction: Direction | None = None) -> Direction:
    """The best that the search finds, OPTIMAL or INFEASIBLE as far as it knows: for the referee to judge.

    contradiction: by what J and b alone, in lengths of their own, are infeasible; those of a metric may hide it.
    Where the radius is huge beside all bounds they would be rounding in its unit. So it is a smaller ball at first,
    whose answer is that of the other where it ends inside.
    """
    ball = _Ball.of(flat, float(flat.problem.radius or 0.0))
    known = None if contradiction is None else ball.inside(contradiction)
    if known is not None and (missed := _find_miss(core, ball.small, known)) is not None:
        return ball.outside(missed)
    named = float(np.abs(ball.small.bound).max(initial=0.0))
    if 0.0 < named < 1.0 / (_HUGE * _WIDE):
        near = _Ball.of(flat, ball.radius * named * _WIDE)
        found = _search(core, near.small)
        if found.error <= _EXACT and norm(found.point) < 1.0 - _ROUNDING:
            return near.outside(found)
    return ball.outside(_search(core, ball.small))


def climb_on_face(small: SmallProblem, radius: float, face: Bool[np.ndarray, "m"]) -> list[Any]:
    """(x, μ, κ) on the sphere, and of x = q where q is the end of the path; see the module's head.

    Unit rows are rounded, which tilts rows at an angle θ by eps/θ, and d with them: for the last digits rows as given.
    """
    g, rows, bound = small.center, small.rows[face], small.bound[face]
    both = np.stack([0.0 * g, g]), np.stack([rows, rows]), np.stack([bound, 0.0 * bound]), np.ones((2, len(rows)), bool)
    answers, found = project_batch(ProblemBatch.trusted(*both), _NEARLY_TIGHT, tangent=True), list[Any]()
    if answers.status.any():  # OPTIMAL is 0
        return []
    (q, p), (beta, gamma) = answers.value, answers.multipliers
    with np.errstate(over="ignore"):  # what is asked for beyond 1e154 is beyond any ball
        length, strength, shortest = math.sqrt(p @ p), math.sqrt(g @ g), math.sqrt(q @ q)
    if length > _NEGLIGIBLE * strength and shortest < radius:
        kappa = length / math.sqrt((radius - shortest) * (radius + shortest))
        found.append((q + p / kappa, face, kappa * beta + gamma, kappa))
    if length <= math.sqrt(_NEGLIGIBLE) * strength and shortest <= radius:
        slack = small.rows @ q - small.bound
        tight = face | (np.abs(slack) <= _NEARLY_TIGHT * radius * lengths(small.rows))
        none, on = np.zeros(tight.sum()), np.ones(tight.sum(), np.bool_)
        least = project(DirectionProblem.trusted(g, small.rows[tight], none, on), _NEARLY_TIGHT, tangent=True)
        found.append((q, tight, least.multipliers, 0.0))
    for k, (x, on, weights, kappa) in enumerate(found):
        mu, equality = np.zeros(len(face)), small.equality[on]
        if (weights[~equality] < 0.0).any():  # dependent rows have many multipliers, few with the right signs
            weights = nonnegative_weights(small.rows[on].T, kappa * x - g, equality)
        mu[on] = weights
        found[k] = x, mu, kappa
    return found


@dataclass(frozen=True, eq=False)
class _Ball:
    """A problem in units of a radius and of ‖g‖, on the rows that can matter in the ball, in few coordinates.

    small: d = radius · basis x; kept: (m,), its rows.
    """

    flat: Flat
    small: SmallProblem
    basis: Float[np.ndarray, "n k"]
    kept: Bool[np.ndarray, "m"]
    strength: float
    radius: float

    @classmethod
    def of(cls, flat: Flat, radius: float) -> "_Ball":
        problem, rows = flat.problem, flat.unit
        strength = math.sqrt(problem.gradient @ problem.gradient)  # whose numbers are about 1
        with np.errstate(over="ignore", under="ignore"):
            bound = np.clip(rows.per_length(problem.bound) / radius, -np.inf, _LARGEST_RATIO)
        bound = np.where(problem.equality, np.maximum(bound, -_LARGEST_RATIO), bound)
        kept = (rows.largest > 0.0) & (problem.equality | (bound > NEGLIGIBLE_BOUND))  # in the ball Âx ≥ −1
        center = problem.gradient / (strength or 1.0)
        small = SmallProblem(center, rows.jacobian[kept], bound[kept], problem.equality[kept])
        return cls(flat, *reduce_problem(small), kept, strength, radius)

    def inside(self, proven: Direction) -> BallAnswer | None:
        """An INFEASIBLE answer in these coordinates; None where its proof names a row that is met all over the ball."""
        y = self.flat.proof(proven.multipliers)
        if y[~self.kept].any():  # of a row of zeros too
            return None
        y = self.flat.unit.times_length(y)
        if not np.isfinite(y).all():
            return None
        point = self.basis.T @ self.flat.inside(proven.value) / self.radius
        return BallAnswer(point, y[self.kept], 0.0, 0.0, Status.INFEASIBLE)

    def outside(self, found: BallAnswer) -> Direction:
        """In the problem's units."""
        problem, rows = self.flat.problem, self.flat.unit
        asks = np.where(problem.equality, problem.bound != 0.0, problem.bound > 0.0)
        impossible = (rows.largest == 0.0) & asks
        multipliers = np.zeros(len(asks))
        multipliers[self.kept] = found.multipliers
        strength = 1.0 if found.status == Status.INFEASIBLE else self.strength  # a proof has no unit
        with np.errstate(over="ignore", under="ignore"):
            point, kappa = self.basis @ found.point * self.radius, found.kappa * (strength / self.radius)
            multipliers = np.where(self.kept, strength * rows.per_length(multipliers), 0.0)
        if impossible.any():
            proof = np.where(impossible, np.sign(problem.bound), 0.0)
            return Direction(point, proof, Status.INFEASIBLE, found.iterations, rung="rows")
        return Direction(point, multipliers, found.status, found.iterations, kappa, rung="rows")


def _search(core: Core, small: SmallProblem) -> BallAnswer:
    """OPTIMAL, INFEASIBLE, or what the core says of its failure."""
    if not small.center.size:  # neither g nor a row
        return BallAnswer(small.center, small.bound, 0.0, 0.0)
    asked = float(demand(small.bound, small.equality).max(initial=0.0))
    climbs, is_beyond = bool(small.center.any()), asked > 1.0 + _ROUNDING  # a row that no point of the ball meets
    if is_beyond and (missed := _find_miss(core, small)) is not None:
        return missed
    found = _climb(core, small, _FEW_STEPS) if climbs else _shortest(small)
    if asked > 0.0 and (
        found.error > _EXACT or is_missed(small.bound, small.rows @ found.point - small.bound, small.equality)
    ):
        missed = _find_miss(core, small)
        if missed is not None:
            return missed
    if climbs and found.error > _EXACT:
        found = _better(found, _climb(core, small, _MOST_STEPS))
    return found


def _climb(core: Core, small: SmallProblem, most_steps: int) -> BallAnswer:
    """The search over t."""
    best = BallAnswer(0.0 * small.center, np.zeros(len(small.bound)), 0.0, status=Status.NUMERICAL_ERROR)
    low, high, t, changes = 0.0, np.inf, 1.0, 0
    for step in range(most_steps):
        x, mu, suggested = t * small.center, np.zeros(len(small.bound)), np.nan
        slack = small.rows @ x - small.bound
        if not np.where(small.equality, slack == 0.0, slack >= 0.0).all():  # else there is nothing to find
            answer = core(replace(small, center=x))
            changes += answer.iterations
            if not answer.is_usable:
                if best.status != Status.OPTIMAL:
                    best = replace(best, status=answer.failure or Status.NUMERICAL_ERROR)
                break
            x, mu = np.asarray(answer.point), np.asarray(answer.multipliers)
            slack = small.rows @ x - small.bound
        face = small.equality | (mu > np.maximum(slack, 0.0))
        for each in (*climb_on_face(small, 1.0, face), (x, mu / t, 1.0 / t)):
            if best.error > _EXACT or each[2] == 0.0:
                best = _better(best, _judge(small, *each))
                suggested = 1.0 / each[2] if each[2] > 0.0 and suggested != suggested else suggested
        if best.error <= _EXACT:
            break
        low, high = (low, t) if math.sqrt(x @ x) > 1.0 else (t, high)
        t = _next_step(low, high, suggested if step % 3 < 2 else np.nan)
        if t > _LARGEST_STEP or high - low <= 1e-15 * low:
            break
    return replace(best, iterations=changes)


def _better(best: BallAnswer, candidate: BallAnswer) -> BallAnswer:
    """Of two the more exact; of two that are exact, the shorter."""
    if max(best.error, candidate.error) <= _EXACT:
        return candidate if candidate.point @ candidate.point < best.point @ best.point else best
    return candidate if candidate.error < best.error else best


def _next_step(low: float, high: float, suggested: float) -> float:
    """The suggestion where it lies inside the bracket, else its middle."""
    if low < suggested < high:
        return suggested
    if high == np.inf:
        return _FARTHER * max(low, 1.0)
    if low < high / _FARTHER:
        return float(np.sqrt(low * high)) if low > 0.0 else high / _FARTHER
    return 0.5 * (low + high)


def _judge(small: SmallProblem, x: Vector, mu: Multipliers, kappa: float) -> BallAnswer:
    """With the worst residual, as the referee has it in these units."""
    named = np.abs(small.bound[small.bound != 0.0])
    rest, size = kappa * x - small.center - mu @ small.rows, math.sqrt(x @ x)
    unit = max(size, float(named.min(initial=1.0)))
    pull, room, slack = kappa * unit, (1.0 - size) / unit, (small.rows @ x - small.bound) / unit
    allowed = min(8 * _EPS * (float(np.abs(mu).sum()) + abs(pull)), 1e-5)
    stationarity = math.sqrt(rest @ rest) - allowed
    rows = np.where(small.equality, np.abs(slack), np.abs(np.minimum(mu, slack)))  # of −slack and −μ too
    worst = max(stationarity, float(rows.max(initial=0.0)), abs(min(pull, room)))
    return BallAnswer(x, mu, kappa, worst if worst == worst else np.inf)


def _shortest(small: SmallProblem) -> BallAnswer:
    """The shortest point of C, κ = μ = 0: the answer where nothing is to be climbed."""
    found = project(as_problem(replace(small, center=0.0 * small.center)), _EXACT)
    is_inside = found.status == Status.OPTIMAL and norm(found.value) <= 1.0 + _ROUNDING
    status = Status.UNCERTIFIED if found.status == Status.INFEASIBLE else found.status
    error = 0.0 if is_inside else np.inf
    return BallAnswer(found.value, np.zeros(len(small.bound)), 0.0, error, status, found.iterations)


def _find_miss(core: Core, small: SmallProblem, known: BallAnswer | None = None) -> BallAnswer | None:
    """INFEASIBLE where C is empty or the ball misses it: the least violation, and of those the best climb.

    known: what proves C empty and violates least in other lengths, though it may not in these.
    None where the ball and C are nearer than VIOLATION_TOLERANCE.
    """
    flat = as_problem(replace(small, center=0.0 * small.center))
    empty = infeasible_direction(flat)
    if empty is not None and norm(empty.value) <= 1.0:
        within = _climb(core, _relax(small, empty.value), _MOST_STEPS) if small.center.any() else None
        point = empty.value if within is None or not within.error <= VIOLATION_TOLERANCE else within.point
        return BallAnswer(point, empty.multipliers, 0.0, error=0.0, status=Status.INFEASIBLE)
    if empty is None and known is not None and norm(known.point) <= 1.0:
        return known
    if empty is None and known is None and norm(project(flat, _EXACT).value) <= 1.0:
        return None
    size = max(1.0, float(demand(small.bound, small.equality).max(initial=0.0)))
    point, violation = least_violation_in_ball(small.rows, small.bound, small.equality)
    length = norm(violation)
    proven = empty or known
    if proven is None and length <= VIOLATION_TOLERANCE * size:
        return None
    proof = violation / length if proven is None else proven.multipliers
    return BallAnswer(point, proof, 0.0, status=Status.INFEASIBLE)


def _relax(small: SmallProblem, point: Vector) -> SmallProblem:
    """C of the points that violate the rows as this one does: by just as much where it does."""
    reached = small.rows @ point
    size = max(norm(point), float(demand(small.bound, small.equality).max(initial=0.0))) or 1.0
    equality = small.equality | (small.bound - reached > _ROUNDING * size)
    bound = np.where(equality, reached, np.minimum(small.bound, reached))
    # Where nothing but rounding is left of the bounds, rounding would be what the problem asks for.
    return replace(small, bound=np.where(np.abs(bound) <= _ROUNDING * size, 0.0, bound), equality=equality)
