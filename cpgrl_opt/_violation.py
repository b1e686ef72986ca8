"""How far constraints are from being met, and from being impossible to meet: violations and Farkas vectors.

All of it on unit rows Ĵᵢ = Jᵢ/‖Jᵢ‖, b̂ᵢ = bᵢ/‖Jᵢ‖, and where M = I; r = (b̂ − Ĵd)₊ on I, b̂ − Ĵd on E.
Source: Farkas' lemma; Boyd & Vandenberghe, Convex Optimization, §5.8; Hoffman 1952.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .arrays import Float, Mask, Multipliers, Vector
from .flat import flatten
from .problem import DirectionProblem, require_problem, require_rows
from .scaling import demand, lengths, norm, unit_rows
from .validation import real_values, require_shape

# Worst `farkas_residual` and `least_violation_residual` of our own proofs. A violation of 1e-9, the least that counts,
# has seven digits, so its proof is this good at worst; with 1e-7 it would be refused, and with 1e-5 one of 1e-10,
# which may be rounding, would count. Sizeable violations reach 1e-15.
FARKAS_TOLERANCE = 1e-6
# A violation that is worth a look: in units of its bound. With 1e-10 rounding is, with 1e-8 a contradiction of 1e-8
# passes for rounding; the compiled core has the same.
_MISSED = 1e-9
# A violation is as good as none at this part of all lengths: with 1e-12 what rounding leaves would be asked to point
# nowhere, with 1e-6 directions that violate by 1e-7 more than they must would violate least.
_LEAST = 1e-9
# A problem counts as infeasible where what meets its constraints is proven to be this many times as long as d and g.
# With 10 rows that nearly oppose each other, and are met a little farther than the claim goes, would be; with 1000 a
# proof to √ε of a d that is 1e3 times max|b̂| long would not do for ε = 1e-9.
_FAR = 100.0
# In a ball d is as long as it is wide, whatever the constraints ask for: there a proof is as good as one without a ball
# where no more than this part of it is left of Jᵀy. With 1e10 rows 1e-10 rad from opposing would contradict each other,
# which are met at 1e10 times the bounds; with 1e14 what rounding leaves, 1e-16 a row, would not do.
_BEYOND = 1e12
# What rounding leaves of b̂ᵀŷ − radius ‖Ĵᵀŷ‖, in units of max(|b̂|, radius) Σ|ŷ|.
_ROUNDED_GAIN = 8 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Violation:
    """r (m,), 0 where nothing is violated; the unit rows (m, n) it is of; and the largest of (b̂ᵢ)₊, |b̂ᵢ| on E."""

    amount: np.ndarray
    jacobian: np.ndarray
    demanded: float


def violation(problem: DirectionProblem, d: Vector) -> Violation:
    """The violation of d, M = I; zero rows, which no d can mend, are left out."""
    rows = unit_rows(problem.jacobian)
    on = (rows.largest > 0) & (problem.bound > -np.inf)
    bound = np.where(on, rows.per_length(problem.bound), 0.0)
    lack = np.where(on, bound - rows.jacobian @ d, 0.0)
    amount = np.where(problem.equality, lack, np.maximum(lack, 0.0))
    return Violation(amount, rows.jacobian, largest(demand(bound, problem.equality)))


def misses_a_bound(problem: DirectionProblem, d: Any) -> bool:
    """Whether d misses a row by more than 1e-9 of the least that any asks for: rows may contradict each other.

    In the rows' own lengths, whatever the metric. Rows that ask for nothing, b = 0, are missed too where they
    contradict one that asks.
    """
    if not problem.bound.any():
        return False
    J, d = problem.jacobian, problem.row_of(d) if problem.is_tree else d
    size = lengths(J)
    size[size == 0.0] = 1.0  # a zero row that asks for something is missed, however little it is
    with np.errstate(over="ignore", invalid="ignore"):
        return is_missed(problem.bound / size, (J @ d - problem.bound) / size, problem.equality)


def is_missed(bound: np.ndarray, slack: np.ndarray, equality: Mask | bool) -> bool:
    """The same of b̂ and Ĵd − b̂, (…, m): whether any run misses a bound."""
    asked, lack = np.where(equality, np.abs(bound), bound), np.where(equality, np.abs(slack), -slack)
    least = asked.min(axis=-1, initial=np.inf, where=asked > 0.0)
    return bool((lack.max(axis=-1, initial=0.0) > _MISSED * least).any())


def least_violation_residual(problem: DirectionProblem, d: Vector) -> float:
    """How far d is from violating least: ‖Ĵᵀr‖ / max(‖r‖, 1e-9·s); M = I, no radius.

    −Ĵᵀr is the gradient of the convex ½‖r‖². s = max(‖g‖, ‖d‖, (b̂ᵢ)₊, |b̂ᵢ| on E): an r of rounding size is none.
    """
    d = _check_direction(problem, d)
    if not np.isfinite(d).all():
        return math.inf
    lack = violation(problem, d)
    size = max(norm(lack.amount), _LEAST * max(norm(problem.gradient), norm(d), lack.demanded))
    return norm(lack.amount / size @ lack.jacobian) if size > 0 else 0.0


def excess_violation(problem: DirectionProblem, d: Vector) -> float:
    """How much less d could violate: ‖Ĵᵀr‖ / s, s as in `least_violation_residual`; infinite where d is not finite.

    In the unit of the KKT residuals, so that a solver need be no more exact than where it claims to be optimal: r is
    within 2H‖Ĵᵀr‖ of the least one, H being Hoffman's constant. In a ball ‖Π(d + Ĵᵀr) − d‖ / s, Π the projection onto
    it, s = max(‖d‖, (b̂ᵢ)₊, |b̂ᵢ| on E) and no more than the radius: 0 where d is in the ball and no other point of it
    violates less, Π(d + Ĵᵀr) being a step of projected descent.
    """
    d = _check_direction(problem, d)
    if not np.isfinite(d).all() or (problem.metric is not None and flatten(problem).failure is not None):
        return math.inf
    flat, d, radius = _flatten(problem, d)
    if not (np.isfinite(d).all() and np.isfinite(flat.jacobian).all()):
        return math.inf
    lack = violation(flat, d)
    unit = max(norm(d), lack.demanded)
    unit = max(unit, norm(flat.gradient)) if radius is None else min(unit, radius)
    if not 0.0 < unit < np.inf:  # a bound overflows in units of its row, or there is nothing at all
        return math.inf if unit else 0.0
    pull, d = lack.amount / unit @ lack.jacobian, d / unit
    if radius is None:
        return norm(pull)
    return norm((d + pull) * min(1.0, radius / unit / (norm(d + pull) or 1.0)) - d)


def is_in_ball(problem: DirectionProblem, d: Vector) -> bool:
    """Whether √(dᵀMd) is at most the radius, but for rounding."""
    _, x, radius = _flatten(problem, problem.row_of(d))
    return radius is None or norm(x) <= radius * (1.0 + _LEAST)


def violation_tolerance(tolerance: float, m: int) -> float:
    """(1 + m) ε, the largest `excess_violation` of an INFEASIBLE answer, ε the solver's tolerance: ε for each row."""
    return (1 + m) * tolerance


def proof_tolerance(tolerance: float) -> float:
    """√ε, the largest `farkas_residual` of an INFEASIBLE answer, ε the solver's tolerance.

    A violation that is good to ε max|b̂| gives a Farkas vector of residual ε (max|b̂|/violation)² only.
    """
    return math.sqrt(tolerance)


def farkas_residual(problem: DirectionProblem, y: Multipliers) -> float:
    """How far y is from proving infeasibility: max(‖Ĵᵀŷ‖, max(−ŷ)₊ on I) / (b̂ᵀŷ / max|b̂|); infinite if b̂ᵀŷ ≤ 0.

    With y ≥ 0 on I, Jᵀy = 0 and bᵀy > 0 no d has Jd ≥ b: 0 = yᵀJd ≥ bᵀy > 0. Zero where y proves it exactly.
    With a radius bᵀy > radius ‖Jᵀy‖_M⁻¹ is enough, since yᵀJd ≤ radius ‖Jᵀy‖_M⁻¹ in the ball; then the residual is at
    most max(8·eps·Σ|ŷ|, max(−ŷ)₊ on I) / ((b̂ᵀŷ − radius ‖Ĵᵀŷ‖) / max(|b̂|, radius)). In a metric, where M = I.
    """
    require_problem(problem)
    require_rows(problem)
    y = real_values("y", y)
    require_shape("y", y, (problem.m,))
    proof, radius = _read(problem, y)
    if radius is None or not 0.0 < proof.size < math.inf:
        return proof.residual
    unit = max(proof.size, radius)
    gain = proof.gain * (proof.size / unit) - radius / unit * proof.force
    return min(proof.residual, max(_ROUNDED_GAIN * proof.weight, proof.negative) / gain if gain > 0 else math.inf)


def is_out_of_reach(problem: DirectionProblem, d: Vector, y: Multipliers) -> bool:
    """Whether y proves that all that meets the constraints is a hundred times as long as d and g, or leaves the ball.

    No direction shorter than b̂ᵀŷ/‖Ĵᵀŷ‖ meets them. In a ball g is no length.
    """
    flat, size, radius = _flatten(problem, problem.row_of(d))
    proof, length = _read(problem, y)[0], norm(size)
    reach = proof.size / proof.residual if proof.residual > 0.0 else math.inf
    if radius is None:
        return reach >= _FAR * max(length, norm(flat.gradient))
    return reach >= min(radius, _FAR * length, _BEYOND * proof.gain * proof.size)


class _Proof(NamedTuple):
    """‖Ĵᵀŷ‖, max(−ŷ)₊ on I, b̂ᵀŷ / max|b̂|, max|b̂| and Σ|ŷ|, of ŷ whose largest number is 1."""

    force: float = math.inf
    negative: float = math.inf
    gain: float = 0.0
    size: float = 0.0
    weight: float = 0.0

    @property
    def residual(self) -> float:
        """How far it is from a proof without a ball."""
        return max(self.force, self.negative) / self.gain if self.gain > 0 else math.inf


def _read(problem: DirectionProblem, y: Multipliers) -> tuple[_Proof, float | None]:
    """What y proves where M = I, and the radius there."""
    if not (np.isfinite(y).all() and y.any()):
        return _Proof(), None
    if problem.metric is not None:
        flat = flatten(problem)
        if flat.failure is not None:
            return _Proof(), None
        if callable(problem.metric):  # rows that depend to its tolerance are one in its coordinates, and prove nothing
            return _read_rows(flat.problem, y, partial(_pull, problem)), problem.radius
        problem, y = flat.problem, flat.proof(y)
    return _read_rows(problem, y), problem.radius


def _pull(problem: DirectionProblem, y: Multipliers) -> float:
    """√(vᵀM⁻¹v) of v = Jᵀy, by M⁻¹ itself; infinite where that is not reached."""
    force = y @ problem.jacobian
    moved, is_reached = problem.whitening.solve(force)
    return math.sqrt(max(float(force @ moved), 0.0)) if is_reached else math.inf


def _read_rows(problem: DirectionProblem, y: Multipliers, pull: Callable[[Multipliers], float] | None = None) -> _Proof:
    if not (np.isfinite(problem.jacobian).all() and (problem.bound < np.inf).all()):
        return _Proof()
    rows, inequality = unit_rows(problem.jacobian), ~problem.equality
    is_zero = rows.largest == 0
    asks = is_zero & (y != 0) & np.where(inequality, problem.bound > 0, np.sign(problem.bound) * y > 0)
    if asks.any() and not y[~is_zero].any():  # 0 ≥ bᵢ > 0 is a contradiction in itself
        return _Proof() if (y[inequality] < 0).any() else _Proof(0.0, 0.0, 1.0, math.inf, 1.0)
    weights = rows.times_length(y / np.abs(y).max(), float(rows.largest.max()) or 1.0)
    is_on = (problem.bound > -np.inf) & ~is_zero
    if not weights.any() or weights[~is_on].any():  # only on rows that ask for nothing; or on one that is off
        return _Proof()
    weights = weights / np.abs(weights).max()
    bound = np.where(is_on, rows.per_length(problem.bound), 0.0)
    size = float(np.abs(bound[weights != 0]).max())
    gain = float((bound / size) @ weights) if size > 0 else 0.0
    force = norm(weights @ rows.jacobian) if pull is None else pull(rows.per_length(weights))
    negative = largest(-weights[inequality])
    return _Proof(force, negative, gain, size, float(np.abs(weights).sum()))


def _check_direction(problem: DirectionProblem, d: Any) -> Vector:
    """d, (n,); ValueError for another shape, and for a problem that shows no rows."""
    require_problem(problem)
    require_rows(problem)
    row = np.asarray(problem.row_of(d))
    require_shape("d", row, (problem.n,))
    return row


def _flatten(problem: DirectionProblem, d: Vector) -> tuple[DirectionProblem, Float[np.ndarray, "k"], float | None]:
    """The problem, d and the radius where M = I; in a metric in units where numbers are about 1."""
    if problem.metric is None:
        return problem, d, problem.radius
    flat = flatten(problem)
    return flat.problem, flat.inside(d), flat.problem.radius


def largest(values: np.ndarray) -> float:
    """The largest, 0 where none is positive."""
    return float(values.max(initial=0.0))
