"""The trust region by a one-dimensional search around a cone solver.

    max gᵀx  s.t.  x ∈ C = {Jx ≥ b, = on E},  ‖x‖ ≤ 1                   with  ‖g‖ = ‖Jᵢ‖ = 1

x(t) = P_C(tg), the projection that a cone solver finds, has a length that grows with t, so x(t) with ‖x(t)‖ = 1 is the
answer, and κ = 1/t, μ = μ(t)/t. Where x(t) stops inside the ball it is the shortest of the directions that climb most,
and κ = 0. The path is piecewise straight: on the face Jᵢx = bᵢ (i ∈ 𝒜), with q its shortest point and p the part of g
along it, p ⟂ q,

    x = q + sp,   s = √(1 − ‖q‖²)/‖p‖,   κ = 1/s,   J_𝒜ᵀμ = κx − g         (p ≠ 0)
    x = q,                               κ = 0,     J_𝒜ᵀμ = −g             (p = 0)

so the search ends with the face and not with a tolerance; for b = 0 that is the face of P_C(g), and
x = P_C(g)/‖P_C(g)‖.
The referee judges each x. Source: Rockafellar, Convex Analysis, §28 (κ); Best 1996, the path of parametric programs.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..arrays import Bool, Float
from ..certify import kkt_residuals
from ..direction import Direction, Status
from ..problem import DirectionProblem
from ..projection import RANK_TOLERANCE
from ..scaling import lengths
from .ball_violation import least_violation_in_ball
from .factorization import pivoted_qr, solve_upper
from .infeasibility import VIOLATION_TOLERANCE, least_violation
from .polishing import nonnegative_weights, off_span

# A residual that ends the search.
_EXACT = 1e-12
# ‖p‖ below this is what rounding leaves of 0.
_NEGLIGIBLE = 1e-13
# Rows this near to their bound may hold the shortest of several best points.
_NEARLY_TIGHT = 1e-9
_ROUNDING = 1e-12
_MOST_STEPS = 80
_LARGEST_STEP = 1e15
_FARTHER = 8.0

Vector = Float[np.ndarray, "n"]
Rows = Float[np.ndarray, "m n"]


@dataclass(frozen=True, eq=False)
class UnitBall:
    """g (n,) of length 1 or 0, J (m, n) with rows of length 1 or 0, b (m,), E (m,); rows of length 0 are off."""

    gradient: Vector
    rows: Rows
    bound: Float[np.ndarray, "m"]
    equality: Bool[np.ndarray, "m"]

    def along(self, t: float) -> DirectionProblem:
        """The problem of x(t): project tg onto C."""
        return DirectionProblem.trusted(t * self.gradient, self.rows, self.bound, self.equality)

    def worst_residual(self, answer: "BallAnswer") -> float:
        """The referee's."""
        problem = self.along(1.0)
        object.__setattr__(problem, "radius", 1.0)
        found = Direction(answer.point, answer.multipliers, Status.UNCERTIFIED, 0, answer.radius_multiplier)
        return kkt_residuals(problem, found).worst

    def relaxed(self, point: Vector, violated: Bool[np.ndarray, "m"]) -> "UnitBall":
        """C of the points that violate the rows as this one does: by just as much where it does."""
        reached = self.rows @ point
        equality = self.equality | violated
        bound = np.where(equality, reached, np.minimum(self.bound, reached))
        size = max(1.0, float(np.abs(self.bound[equality]).max(initial=0.0)))
        # Where nothing but rounding is left of the bounds, rounding would be what the problem asks for.
        return UnitBall(self.gradient, self.rows, np.where(np.abs(bound) <= _ROUNDING * size, 0.0, bound), equality)

    @property
    def asks(self) -> bool:
        """Whether 0 is outside C."""
        return bool(np.where(self.equality, self.bound != 0.0, self.bound > 0.0).any())


@dataclass(frozen=True, eq=False)
class BallAnswer:
    """x (n,), μ (m,), κ of the module's head; for INFEASIBLE μ is y ≥ 0 with bᵀy > ‖Jᵀy‖."""

    point: Vector
    multipliers: Float[np.ndarray, "m"]
    radius_multiplier: float
    status: Status = Status.OPTIMAL
    iterations: int = 0


def on_named_face(ball: UnitBall, answer: BallAnswer) -> Iterator[BallAnswer]:
    """Exact answers on the face of the rows whose multiplier outweighs their slack."""
    slack = ball.rows @ answer.point - ball.bound
    yield from _on_face(ball, ball.equality | (answer.multipliers > np.maximum(slack, 0.0)))


def solve_in_unit_ball(solve: Callable[[DirectionProblem], Direction], ball: UnitBall) -> BallAnswer:
    """The best candidate of the search, OPTIMAL as far as it goes: its residual is for the caller to judge."""
    search = _Search(solve, ball)
    shortest = np.zeros_like(ball.gradient)
    if ball.asks:
        answer = search.project(0.0)
        if answer.status == Status.INFEASIBLE or (answer.status == Status.OPTIMAL and lengths(answer.value) > 1.0):
            missed = _missed(search, ball)
            if missed is not None:
                return missed
        if answer.status != Status.OPTIMAL:
            return search.given_up(answer)
        shortest = answer.value
    if not ball.gradient.any():
        return BallAnswer(shortest, np.zeros(len(ball.bound)), 0.0, Status.OPTIMAL, search.iterations)
    return search.run()


class _Search:
    """The search over t; keeps the best candidate, the bracket, and the solver's iterations."""

    def __init__(self, solve: Callable[[DirectionProblem], Direction], ball: UnitBall) -> None:
        self.solve = solve
        self.ball = ball
        self.iterations = 0
        self.best: BallAnswer | None = None
        self.least = np.inf
        self.low, self.high = 0.0, np.inf

    def project(self, t: float) -> Direction:
        """x(t) as the solver finds it."""
        answer = self.solve(self.ball.along(t))
        self.iterations += int(getattr(answer, "iterations", 0))
        return answer

    def run(self) -> BallAnswer:
        """x with ‖x‖ = 1, or the end of the path."""
        t = 1.0
        for step in range(_MOST_STEPS):
            answer = self.project(t)
            if answer.status != Status.OPTIMAL:
                return self.given_up(answer)
            suggested = self.weigh(answer, t)
            if self.least <= _EXACT:
                break
            if lengths(answer.value) > 1.0:
                self.high = t
            else:
                self.low = t
            t = self.next_step(suggested if step % 3 < 2 else np.nan)
            if t > _LARGEST_STEP or self.high - self.low <= 1e-15 * self.low:
                break
        return self.answer(Status.OPTIMAL)

    def weigh(self, answer: Direction, t: float) -> float:
        """Puts every candidate that x(t) suggests before the referee; the t at which its face leaves the ball."""
        suggested = np.nan
        found = BallAnswer(answer.value, answer.multipliers / t, 1.0 / t)
        self.consider(found)
        for candidate in on_named_face(self.ball, found):
            self.consider(candidate)
            if candidate.radius_multiplier > 0.0:
                suggested = 1.0 / candidate.radius_multiplier
        return suggested

    def consider(self, candidate: BallAnswer) -> None:
        """Takes the candidate if the referee likes it better; of two that are exact, the shorter."""
        worst, better = self.ball.worst_residual(candidate), False
        if self.best is not None and max(worst, self.least) <= _EXACT:
            better = bool(lengths(candidate.point) < lengths(self.best.point))
        if better or (worst < self.least and not self.least <= _EXACT):
            self.best, self.least = candidate, worst

    def next_step(self, suggested: float) -> float:
        """The suggestion where it lies inside the bracket, else its middle."""
        if self.low < suggested < self.high:
            return suggested
        if self.high == np.inf:
            return _FARTHER * max(self.low, 1.0)
        if self.low < self.high / _FARTHER:
            return float(np.sqrt(self.low * self.high)) if self.low > 0.0 else self.high / _FARTHER
        return 0.5 * (self.low + self.high)

    def answer(self, status: Status) -> BallAnswer:
        """The best candidate, 0 if there is none that is finite."""
        best = self.best
        if best is None:
            zeros = np.zeros(len(self.ball.bound))
            return BallAnswer(0.0 * self.ball.gradient, zeros, 0.0, Status.NUMERICAL_ERROR, self.iterations)
        return BallAnswer(best.point, best.multipliers, best.radius_multiplier, status, self.iterations)

    def given_up(self, answer: Direction) -> BallAnswer:
        """What the solver says of its failure, with the best candidate so far, else its own direction in the ball."""
        status = Status(answer.status)
        if status == Status.INFEASIBLE:  # of a set that has a point: nothing to believe
            status = Status.UNCERTIFIED
        if self.best is not None:
            return self.answer(status)
        point = np.asarray(answer.value) / max(1.0, float(lengths(answer.value)))
        return BallAnswer(point, np.zeros(len(self.ball.bound)), 0.0, status, self.iterations)


def _on_face(ball: UnitBall, face: Bool[np.ndarray, "m"]) -> Iterator[BallAnswer]:
    """x on the sphere, and x = q where q is the end of the path; see the module's head."""
    rows, bound, g = ball.rows[face], ball.bound[face], ball.gradient
    Q, R, order = _basis(rows)
    rank = len(R)
    q = Q @ solve_upper(R[:, :rank], bound[order[:rank]], transposed=True)
    p = off_span(Q, g)
    length, room = float(lengths(p)), 1.0 - float(lengths(q))
    if length > _NEGLIGIBLE and room > 0.0:
        s = float(np.sqrt(room * (2.0 - room))) / length
        x, kappa = q + s * p, 1.0 / s
        weights = _weights(ball, face, kappa * q - g)
        yield BallAnswer(x, weights, kappa)
    if length <= np.sqrt(_NEGLIGIBLE) and room >= 0.0:
        tight = face | (np.abs(ball.rows @ q - ball.bound) <= _NEARLY_TIGHT)
        yield BallAnswer(q, _weights(ball, tight, -g), 0.0)


def _weights(ball: UnitBall, face: Bool[np.ndarray, "m"], force: Vector) -> Float[np.ndarray, "m"]:
    """μ with J_𝒜ᵀμ = the force's part in the span of the face's rows, ≥ 0 on I if that is possible."""
    rows = ball.rows[face]
    Q, R, order = _basis(rows)
    rank, target = len(R), Q.T @ force
    weights, chosen = np.zeros(len(rows)), order[:rank]
    weights[chosen] = solve_upper(R[:, :rank], target)
    # One step of refinement: nearly opposing rows have multipliers of 1e9.
    weights[chosen] += solve_upper(R[:, :rank], Q.T @ (Q @ target - weights @ rows))
    if rank < len(rows) and (weights[~ball.equality[face]] < 0.0).any():
        weights = nonnegative_weights(Q.T @ rows.T, target, ball.equality[face])
    multipliers = np.zeros(len(face))
    multipliers[face] = weights
    return multipliers


def _basis(rows: Float[np.ndarray, "p n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if len(rows) == 0:
        return np.zeros((rows.shape[1], 0)), np.zeros((0, 0)), np.zeros(0, dtype=np.intp)
    return pivoted_qr(rows.T, RANK_TOLERANCE)


def _missed(search: _Search, ball: UnitBall) -> BallAnswer | None:
    """INFEASIBLE where the ball misses C, or C is empty: the least violation, and of those the best climb.

    None where the ball and C are nearer than VIOLATION_TOLERANCE.
    """
    size = max(1.0, float(np.where(ball.equality, np.abs(ball.bound), ball.bound).max(initial=0.0)))
    empty = least_violation(ball.along(0.0))
    if empty is not None:
        violated = ball.bound - ball.rows @ empty.direction > _ROUNDING * size
        within = solve_in_unit_ball(search.solve, ball.relaxed(empty.direction, violated))
        if within.status != Status.INFEASIBLE:
            return BallAnswer(within.point, empty.proof, 0.0, Status.INFEASIBLE, search.iterations + within.iterations)
    point, violation = least_violation_in_ball(ball.rows, ball.bound, ball.equality)
    length = float(lengths(violation))
    if length <= VIOLATION_TOLERANCE * size:
        return None
    return BallAnswer(point, violation / length, 0.0, Status.INFEASIBLE, search.iterations)
