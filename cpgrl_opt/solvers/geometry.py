"""Metric and radius as one transformation around any cone solver.

    metric    M = LLᵀ:  min ½‖d′‖² − g′ᵀd′  s.t.  J′d′ ≥ b  in d′ = Lᵀd, g′ = L⁻¹g, J′ = JL⁻ᵀ;  the same μ
    radius    a one-dimensional search over κ, see `ball`

in units where nothing over- or underflows (see `units`), so that the solver itself only ever sees Euclidean problems
without a ball. The referee judges each answer anew on the problem as it was given. Source: Golub & Van Loan, Matrix
Computations, §4.2 (whitening by the Cholesky factor).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..certify import certify, kkt_residuals
from ..direction import Direction, DirectionBatch, Status
from ..problem import DirectionProblem, ProblemBatch, euclidean
from ..scaling import UnitRows, lengths, unit_rows
from ..units import Units, in_units
from .ball import BallAnswer, UnitBall, on_named_face, solve_in_unit_ball
from .infeasibility import infeasible_direction
from .polishing import polish
from .small_problem import scale_problem

Solve = Callable[[DirectionProblem], Direction]

# Demands or lengths beyond this, in units of the radius, have squares that overflow.
_LARGEST_RATIO = 1e150


def solve_transformed(solve: Solve, problem: DirectionProblem, tolerance: float) -> Direction:
    """The answer of `solve`, a Euclidean cone solver, to a problem with a metric, a radius or both."""
    whitened = _Whitened.of(problem)
    if not _is_finite(whitened.flat):
        return Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR)
    if problem.radius is None:
        return _map_back(whitened, solve(whitened.flat), tolerance)
    return _solve_in_ball(solve, whitened, tolerance)


def solve_batch_transformed(
    solve: Solve, batch: Callable[[ProblemBatch], DirectionBatch], problems: ProblemBatch, tolerance: float
) -> DirectionBatch:
    """As one by one; without radii the whitened problems are solved together."""
    members = [_Whitened.of(problem) for problem in problems]
    flat = [each.flat for each in members]
    if problems.radius is not None or not all(_is_finite(each) for each in flat):
        return DirectionBatch.stack([solve_transformed(solve, each.given, tolerance) for each in members])
    answers = batch(
        ProblemBatch.trusted(
            np.stack([each.gradient for each in flat]),
            np.stack([each.jacobian for each in flat]),
            np.stack([each.bound for each in flat]),
            problems.equality,
        )
    )
    return DirectionBatch.stack(
        [_map_back(each, answer, tolerance) for each, answer in zip(members, answers, strict=True)]
    )


def judge_in_geometry(problem: DirectionProblem, found: Direction, tolerance: float) -> Direction:
    """The answer with the status that the referee leaves it; UNCERTIFIED is judged as if it claimed OPTIMAL."""
    numbers = (found.value, found.multipliers, found.radius_multiplier)
    if not all(np.isfinite(each).all() for each in numbers):
        return Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR, found.iterations)
    claim = replace(found, status=Status.OPTIMAL) if found.status == Status.UNCERTIFIED else found
    return certify(problem, claim, tolerance, infeasible_direction)


def polish_in_geometry(problem: DirectionProblem, found: Direction) -> Direction:
    """The best of an answer and the exact ones on the face that it names, as the referee has it."""
    whitened = _Whitened.of(problem)
    flat, named = whitened.flat, whitened.inside(found)
    candidates = [found]
    if not _is_finite(flat) or not np.isfinite(named.value).all():
        return found
    if problem.radius is not None:
        units = _BallUnits.of(whitened.problem, flat)
        if units is not None:
            faces = on_named_face(units.ball, units.to_ball(named))
            candidates += [whitened.outside(units.from_ball(each)) for each in faces]
    else:
        scaled = scale_problem(flat)
        if 0.0 < scaled.scale < np.inf:
            weights = scaled.unit.times_length(named.multipliers, scaled.scale)[scaled.kept]
            for d, mu in polish(scaled.small, named.value / scaled.scale, weights):
                exact = Direction(d * scaled.scale, scaled.original_multipliers(mu), found.status)
                candidates.append(whitened.outside(exact))
    best = min(candidates, key=lambda candidate: kkt_residuals(problem, candidate).worst)
    return replace(best, status=found.status, iterations=found.iterations)


def _solve_in_ball(solve: Solve, whitened: "_Whitened", tolerance: float) -> Direction:
    problem = whitened.problem
    units = _BallUnits.of(problem, whitened.flat)
    if units is None:
        return Direction.nothing(problem.n, problem.m, Status.NUMERICAL_ERROR)
    found = units.from_ball(solve_in_unit_ball(solve, units.ball))
    impossible = (units.rows.largest == 0.0) & np.where(problem.equality, problem.bound != 0.0, problem.bound > 0.0)
    if impossible.any():
        proof = np.where(impossible, np.sign(problem.bound), 0.0)
        found = replace(found, multipliers=proof, status=Status.INFEASIBLE, radius_multiplier=0.0)
    return _map_back(whitened, found, tolerance)


@dataclass(frozen=True, eq=False)
class _Whitened:
    """A problem as it was given, in its units (None: its own), and in the coordinates where M = I, without its ball."""

    given: DirectionProblem
    units: Units | None
    flat: DirectionProblem

    @classmethod
    def of(cls, problem: DirectionProblem) -> "_Whitened":
        """Units are for a metric: without one nothing is multiplied."""
        units = None if problem.metric is None else in_units(problem)
        return cls(problem, units, euclidean(problem if units is None else units.problem))

    @property
    def problem(self) -> DirectionProblem:
        """The problem in its units."""
        return self.given if self.units is None else self.units.problem

    def inside(self, found: Direction) -> Direction:
        """d′ = Lᵀd, in units."""
        numbers = (found.value, found.multipliers, found.radius_multiplier)
        value, multipliers, kappa = numbers if self.units is None else self.units.inside(*numbers)
        whitening = self.problem.whitening
        value = value if whitening is None else whitening.direction(value)
        return Direction(value, multipliers, found.status, found.iterations, kappa)

    def outside(self, answer: Direction) -> Direction:
        """d = L⁻ᵀd′, out of units."""
        value, whitening = np.asarray(answer.value, dtype=np.float64), self.problem.whitening
        value = value if whitening is None else whitening.original(value)
        multipliers = np.asarray(answer.multipliers, dtype=np.float64)
        numbers = (value, multipliers, float(getattr(answer, "radius_multiplier", 0.0)))
        value, multipliers, kappa = numbers if self.units is None else self.units.outside(*numbers)
        iterations, rung = getattr(answer, "iterations", 0), getattr(answer, "rung", "")
        return Direction(value, multipliers, Status(answer.status), iterations, kappa, rung=rung)


@dataclass(frozen=True, eq=False)
class _BallUnits:
    """A Euclidean problem in a ball in units of the radius, with unit rows and a unit gradient: x = d/radius.

    strength: ‖g‖; zero rows are switched off in `ball`.
    """

    ball: UnitBall
    rows: UnitRows
    radius: float
    strength: float

    @classmethod
    def of(cls, problem: DirectionProblem, flat: DirectionProblem) -> "_BallUnits | None":
        """None where the numbers overflow."""
        radius, rows = float(problem.radius or 0.0), unit_rows(flat.jacobian)
        strength, is_zero = float(lengths(flat.gradient)), rows.largest == 0.0
        with np.errstate(over="ignore", under="ignore"):
            bound = np.where(is_zero, -np.inf, rows.per_length(problem.bound) / radius)
        equality = problem.equality & ~is_zero
        if not np.isfinite(strength) or not (np.where(equality, np.abs(bound), bound) < _LARGEST_RATIO).all():
            return None
        return cls(UnitBall(flat.gradient / (strength or 1.0), rows.jacobian, bound, equality), rows, radius, strength)

    def from_ball(self, answer: BallAnswer) -> Direction:
        """In the problem's units, still Euclidean."""
        strength = 1.0 if answer.status == Status.INFEASIBLE else self.strength  # a proof has no unit
        with np.errstate(over="ignore", under="ignore"):
            return Direction(
                answer.point * self.radius,
                strength * self.rows.per_length(np.where(self.rows.largest == 0.0, 0.0, answer.multipliers)),
                answer.status,
                answer.iterations,
                answer.radius_multiplier * (strength / self.radius),
                rung="rows",
            )

    def to_ball(self, found: Direction) -> BallAnswer:
        """The other way."""
        force = self.strength or 1.0
        multipliers = self.rows.times_length(found.multipliers, force)
        return BallAnswer(found.value / self.radius, multipliers, found.radius_multiplier * self.radius / force)


def _map_back(whitened: _Whitened, answer: Direction, tolerance: float) -> Direction:
    """What `solve` claims of the whitened problem, as an answer to the problem itself; only its OPTIMAL may stand."""
    found = whitened.outside(answer)
    if found.status == Status.UNCERTIFIED and np.isfinite(found.value).all():
        return found
    return judge_in_geometry(whitened.given, found, tolerance)


def _is_finite(problem: DirectionProblem) -> bool:
    bound = np.where(problem.equality, np.abs(problem.bound), problem.bound)
    parts = (np.isfinite(problem.gradient), np.isfinite(problem.jacobian), bound < np.inf)
    return all(bool(part.all()) for part in parts)
