"""A problem where M = I, in units in which its numbers are about 1: what solvers and referee see of any geometry.

    M̃ = DMD = LLᵀ:   x = Lᵀd̃,   d = 2^s D d̃,   g̃ = 2^−f Dg,   J̃ᵢ = 2^−kᵢ JᵢD,   b̃ᵢ = 2^−(kᵢ+s) bᵢ,
                     μᵢ = 2^(f−kᵢ) μ̃ᵢ,   κ = 2^(f−s) κ̃

D = diag(2^eⱼ) with ¼ ≤ M̃ⱼⱼ < 1, D = I without a metric; the largest entry of g̃ and of each J̃ᵢ is below 1 and at least
½. Without a radius f = s; with one 2^s is the radius's. Powers of two round nothing, and what underflows here is less
than 1e-300 of what it is compared with; whitening the problem as it was given could lose all of a row or of g.
"""

from dataclasses import dataclass
from operator import is_
from typing import Any

import numpy as np

from .arrays import Float, Int, Multipliers, Vector
from .direction import Status
from .metric_operator import OperatorMetric, Span
from .problem import DirectionProblem
from .scaling import UnitRows, unit_rows

# What is asked for beyond it is as far out of reach as it is.
_LARGEST = 1e300


@dataclass(frozen=True, eq=False)
class Flat:
    """problem: of (L⁻¹g̃, J̃L⁻ᵀ, b̃), with its radius; given: g̃ over J̃; M, and L of M̃; and e (n,), k (m,), s and f.

    Of a metric by products L is a `Span` in which V has its coordinates, and all units are 1.
    """

    problem: DirectionProblem
    given: Float[np.ndarray, "channels n"]
    metric: Any
    whitening: Any  # Whitening or Span; None where M = I
    columns: Int[np.ndarray, "n"]
    rows: Int[np.ndarray, "m"]
    length: int
    force: int
    failure: Status | None  # NUMERICAL_ERROR where a number overflowed
    unit: UnitRows

    def in_units(self, d: Vector, mu: Multipliers, kappa: float) -> tuple[Vector, Multipliers, float]:
        """(d̃, μ̃, κ̃) of (d, μ, κ)."""
        with np.errstate(over="ignore", under="ignore"):
            scaled = float(np.ldexp(kappa, self.length - self.force))
            return np.ldexp(d, -self.columns - self.length), np.ldexp(mu, self.rows - self.force), scaled

    def inside(self, d: Vector) -> Vector:
        """x of d."""
        with np.errstate(over="ignore", under="ignore"):
            d = np.ldexp(d, -self.columns - self.length)
        return d if self.whitening is None else self.whitening.direction(d)

    def outside(self, x: Vector, mu: Multipliers, kappa: float) -> tuple[Vector, Multipliers, float]:
        """(d, μ, κ) of (x, μ̃, κ̃)."""
        d = x if self.whitening is None else self.whitening.original(x)
        with np.errstate(over="ignore", under="ignore"):
            scaled = float(np.ldexp(kappa, self.force - self.length))
            return np.ldexp(d, self.columns + self.length), np.ldexp(mu, self.force - self.rows), scaled

    def proof(self, y: Multipliers) -> Multipliers:
        """ỹ of y ≠ 0, up to a factor."""
        used = self.rows[y != 0.0]
        with np.errstate(over="ignore", under="ignore"):
            return np.asarray(np.ldexp(y / np.abs(y).max(), self.rows - int(used.max(initial=0))))


def flatten(problem: DirectionProblem) -> Flat:
    """The problem where M = I, in its units; found once."""
    known: tuple[tuple[Any, ...], Flat] | None = vars(problem).get("_flat")
    given = (problem.gradient, problem.jacobian, problem.bound, problem.equality, problem.metric, problem.radius)
    if known is None or not all(map(is_, known[0], given)):
        by_product = isinstance(problem.whitening, OperatorMetric)
        known = given, (_flatten_in_span if by_product else _flatten)(problem)
        if problem.metric is not None or not problem.is_long:  # else it would be a copy of all for a rare look
            vars(problem)["_flat"] = known
    return known[1]


def _flatten(problem: DirectionProblem) -> Flat:
    bound, radius = problem.bound, problem.radius
    columns, whitening = problem.whitening.balanced if problem.whitening is not None else (np.zeros(1, np.int64), None)
    given = np.vstack([problem.gradient, problem.jacobian])
    none = np.iinfo(np.int64).min
    exponents = np.where(given != 0.0, np.frexp(given)[1] + columns, none).max(axis=1, initial=none)
    exponents[exponents == none] = 0
    rows, strength = exponents[1:], int(exponents[0])
    if radius is not None:
        length, force = int(np.frexp(radius)[1]), strength
    else:  # of the larger of g and what the bounds demand
        demands = np.isfinite(bound) & (bound != 0.0) & (problem.equality | (bound > 0.0))
        sizes = (np.frexp(bound)[1] - rows)[demands].tolist() + [strength] * bool(problem.gradient.any())
        length = force = max(sizes, default=0)
    exponents[0] = force
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        given = np.ldexp(given, columns - exponents[:, None])
        beyond = np.ldexp(bound, -rows - length)  # of a tiny radius
        bound = np.where(np.isfinite(bound), np.clip(beyond, -_LARGEST, _LARGEST), bound)
        vectors = given if whitening is None else whitening.rows(given)
        unit = unit_rows(vectors[1:])
        radius = None if radius is None else float(np.ldexp(radius, -length))
    is_finite = np.isfinite(vectors).all() and (np.where(problem.equality, np.abs(bound), bound) < np.inf).all()
    failure = None if is_finite else Status.NUMERICAL_ERROR
    flat = DirectionProblem.trusted(vectors[0], vectors[1:], bound, problem.equality, radius)
    columns = np.broadcast_to(columns, vectors[0].shape)
    return Flat(flat, given, problem.metric, whitening, columns, rows, length, force, failure, unit)


def _flatten_in_span(problem: DirectionProblem) -> Flat:
    g, J, bound = problem.gradient, problem.jacobian, problem.bound
    span = Span.of(problem.whitening, g, J, bound > -np.inf)
    flat = DirectionProblem.trusted(span.rows[0], span.rows[1:], bound, problem.equality, problem.radius)
    ones = np.broadcast_to(np.int64(0), problem.n), np.zeros(problem.m, np.int64), 0, 0
    return Flat(flat, span.rows, problem.metric, span, *ones, span.failure, unit_rows(flat.jacobian))
