"""How far constraints are from being met, and from being impossible to meet: violations and Farkas vectors."""

import math
from dataclasses import dataclass

import numpy as np

from .arrays import Mask, Multipliers, Vector
from .problem import DirectionProblem, euclidean
from .scaling import lengths, unit_rows
from .units import in_units
from .validation import real_values, require_shape

_EPS = float(np.finfo(np.float64).eps)
# What rounding leaves of b̂ᵀŷ − radius ‖Ĵᵀŷ‖, in units of max(|b̂|, radius) Σ|ŷ|.
_ROUNDED_GAIN = 8 * _EPS
# A violation of 1e-9 has seven digits, so its certificate is this good at worst; sizeable violations reach 1e-15.
FARKAS_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Violation:
    """b̂ − Ĵd where it violates, 0 elsewhere: amount (m,), signed on E; and the unit rows (m, n) and b̂ (m,) it is of."""

    amount: np.ndarray
    jacobian: np.ndarray
    bound: np.ndarray


def violation(problem: DirectionProblem, d: Vector) -> Violation:
    """(b̂ − Ĵd)₊ on I and b̂ − Ĵd on E, on unit rows; zero rows, which no d can mend, are left out."""
    rows = unit_rows(problem.jacobian)
    on = (rows.largest > 0) & (problem.bound > -np.inf)
    bound = np.where(on, rows.per_length(problem.bound), 0.0)
    lack = np.where(on, bound - rows.jacobian @ d, 0.0)
    return Violation(np.where(problem.equality, lack, np.maximum(lack, 0.0)), rows.jacobian, bound)


def least_violation_residual(problem: DirectionProblem, d: Vector) -> float:
    """How far d is from violating least: ‖Ĵᵀr‖ / max(‖r‖, 1e-9·s), r = (b̂ − Ĵd)₊ (signed on E); M = I, no radius.

    −Ĵᵀr is the gradient of the convex ½‖r‖². s = max(‖g‖, ‖d‖, (b̂ᵢ)₊, |b̂ᵢ| on E): an r of rounding size is none.
    """
    d = real_values("d", d)
    require_shape("d", d, (problem.n,))
    if not np.isfinite(d).all():
        return float("inf")
    lack = violation(problem, d)
    size = max(norm(lack.amount), 1e-9 * _violation_unit(problem, d, lack))
    return norm(lack.amount / size @ lack.jacobian) if size > 0 else 0.0


def excess_violation(problem: DirectionProblem, d: Vector) -> float:
    """How much less d could violate: ‖Ĵᵀr‖ / s, r and s as in `least_violation_residual`; in a metric, where M = I.

    In the unit of the KKT residuals, so that a solver need be no more exact than where it claims to be optimal: r is
    within 2H‖Ĵᵀr‖ of the least one, H being Hoffman's constant. A radius is not looked at: violating least has another
    meaning in a ball. Infinite where d is not finite. Source: Hoffman 1952.
    """
    d = real_values("d", d)
    require_shape("d", d, (problem.n,))
    if not np.isfinite(d).all():
        return float("inf")
    if problem.metric is not None:
        units = in_units(problem, d)
        problem, (d, _, _) = units.problem, units.inside(d, np.zeros(problem.m), 0.0)
    flat = euclidean(problem)
    d = d if problem.whitening is None else problem.whitening.direction(d)
    if not (np.isfinite(d).all() and np.isfinite(flat.jacobian).all()):
        return float("inf")
    lack = violation(flat, d)
    unit = _violation_unit(flat, d, lack)
    if not unit < np.inf:  # a bound overflows in units of its row
        return float("inf")
    return norm(lack.amount / unit @ lack.jacobian) if unit > 0 else 0.0


def violation_tolerance(tolerance: float, m: int) -> float:
    """(1 + m) ε, the largest `excess_violation` of an INFEASIBLE answer, ε the solver's tolerance: ε for each row."""
    return (1 + m) * tolerance


def proof_tolerance(tolerance: float) -> float:
    """√ε, the largest `farkas_residual` of an INFEASIBLE answer, ε the solver's tolerance.

    A violation that is good to ε max|b̂| gives a Farkas vector of residual ε (max|b̂|/violation)² only.
    """
    return math.sqrt(tolerance)


def _violation_unit(problem: DirectionProblem, d: Vector, lack: Violation) -> float:
    """s = max(‖g‖, ‖d‖, (b̂ᵢ)₊, |b̂ᵢ| on E)."""
    required = np.where(problem.equality, np.abs(lack.bound), np.maximum(lack.bound, 0.0))
    return max(norm(problem.gradient), norm(d), largest(required))


def farkas_residual(problem: DirectionProblem, y: Multipliers) -> float:
    """How far y is from proving infeasibility: max(‖Ĵᵀŷ‖, max(−ŷ)₊ on I) / (b̂ᵀŷ / max|b̂|); infinite if b̂ᵀŷ ≤ 0.

    With y ≥ 0 on I, Jᵀy = 0 and bᵀy > 0 no d has Jd ≥ b: 0 = yᵀJd ≥ bᵀy > 0. Zero where y proves it exactly.
    With a radius bᵀy > radius ‖Jᵀy‖_M⁻¹ is enough, since yᵀJd ≤ radius ‖Jᵀy‖_M⁻¹ in the ball; then the residual is at
    most max(8·eps·Σ|ŷ|, max(−ŷ)₊ on I) / ((b̂ᵀŷ − radius ‖Ĵᵀŷ‖) / max(|b̂|, radius)). In a metric, where M = I.
    Source: Farkas' lemma; Boyd & Vandenberghe, Convex Optimization, §5.8.
    """
    y = real_values("y", y)
    require_shape("y", y, (problem.m,))
    if not np.isfinite(y).all() or not y.any():
        return float("inf")
    if problem.metric is not None:
        units = in_units(problem)
        problem, y = units.problem, units.proof(y)
    flat = euclidean(problem)
    if not (np.isfinite(flat.jacobian).all() and (problem.bound < np.inf).all() and y.any()):
        return float("inf")
    rows = unit_rows(flat.jacobian)
    zero_row_proof = (rows.largest == 0) & (y != 0) & _zero_row_impossible(problem, y)
    if zero_row_proof.any() and not y[rows.largest > 0].any():
        return float("inf") if (y[~problem.equality] < 0).any() else 0.0
    weights = rows.times_length(y / np.abs(y).max(), float(rows.largest.max()) or 1.0)
    if not weights.any():  # y ≠ 0 on zero rows only, which ask for nothing impossible
        return float("inf")
    weights = weights / np.abs(weights).max()
    switched_on = (problem.bound > -np.inf) & (rows.largest > 0)
    bound = np.where(switched_on, rows.per_length(problem.bound), 0.0)
    if (weights[~switched_on] != 0).any():
        return float("inf")
    force, negative = norm(weights @ rows.jacobian), largest(np.maximum(-weights[~problem.equality], 0.0))
    size = float(np.abs(bound[weights != 0]).max())
    gain = float((bound / size) @ weights) if size > 0 else 0.0
    residual = max(force, negative) / gain if gain > 0 else float("inf")
    if problem.radius is None or not size > 0:
        return residual
    unit = max(size, problem.radius)
    gain = float((bound / unit) @ weights) - problem.radius / unit * force
    rounded = _ROUNDED_GAIN * float(np.abs(weights).sum())
    return min(residual, max(rounded, negative) / gain if gain > 0 else float("inf"))


def _zero_row_impossible(problem: DirectionProblem, y: Multipliers) -> Mask:
    return np.where(problem.equality, np.sign(problem.bound) * y > 0, problem.bound > 0)


def norm(vector: np.ndarray) -> float:
    """‖v‖₂, without the overhead of `lengths` where the square neither over- nor underflows."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        square = float(vector @ vector)
    return math.sqrt(square) if 1e-280 < square < 1e280 else float(lengths(vector))


def largest(values: np.ndarray) -> float:
    """The largest, 0 where none is positive."""
    return float(values.max(initial=0.0))
