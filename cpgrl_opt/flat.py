"""A problem where M = I, in units in which its numbers are about 1: what solvers and referee see of any geometry.

    M̃ = DMD = LLᵀ:   x = Lᵀd̃,   d = 2^s D d̃,   g̃ = 2^−f Dg,   J̃ᵢ = 2^−kᵢ JᵢD,   b̃ᵢ = 2^−(kᵢ+s) bᵢ,
                     μᵢ = 2^(f−kᵢ) μ̃ᵢ,   κ = 2^(f−s) κ̃

D = diag(2^eⱼ) with ¼ ≤ M̃ⱼⱼ < 1, D = I without a metric; the largest entry of g̃ and of each J̃ᵢ is below 1 and at least
½. Without a radius f = s; with one 2^s is the radius's. Powers of two round nothing, and what underflows here is less
than 1e-300 of what it is compared with; whitening the problem as it was given could lose all of a row or of g.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import Float, Int, Multipliers, Vector
from .direction import Status
from .flat_span import SpanFlat
from .metric import Metric, Whitening, balancing_exponents
from .metric_operator import OperatorMetric
from .problem import DirectionProblem, euclidean
from .validation import read_only


@dataclass(frozen=True, eq=False)
class Flat:
    """problem: of (L⁻¹g̃, J̃L⁻ᵀ, b̃), with its radius; units: of (M̃, g̃, J̃, b̃); e (n,), k (m,), s and f."""

    problem: DirectionProblem
    units: DirectionProblem
    columns: Int[np.ndarray, "n"]
    rows: Int[np.ndarray, "m"]
    length: int
    force: int

    @property
    def failure(self) -> Status | None:
        """NUMERICAL_ERROR where a number overflowed."""
        flat = self.problem
        asked = np.where(flat.equality, np.abs(flat.bound), flat.bound)
        is_finite = np.isfinite(flat.gradient).all() and np.isfinite(flat.jacobian).all() and (asked < np.inf).all()
        return None if is_finite else Status.NUMERICAL_ERROR

    def in_units(self, d: Vector, mu: Multipliers, kappa: float) -> tuple[Vector, Multipliers, float]:
        """(d̃, μ̃, κ̃) of (d, μ, κ)."""
        return (
            _shifted(d, -self.columns - self.length),
            _shifted(mu, self.rows - self.force),
            float(_shifted(np.array(kappa), self.length - self.force)),
        )

    def inside(self, d: Vector) -> Vector:
        """x of d."""
        d = _shifted(d, -self.columns - self.length)
        return d if self.units.whitening is None else self.units.whitening.direction(d)

    def outside(self, x: Vector, mu: Multipliers, kappa: float) -> tuple[Vector, Multipliers, float]:
        """(d, μ, κ) of (x, μ̃, κ̃)."""
        d = x if self.units.whitening is None else self.units.whitening.original(x)
        return (
            _shifted(d, self.columns + self.length),
            _shifted(mu, self.force - self.rows),
            float(_shifted(np.array(kappa), self.force - self.length)),
        )

    def proof(self, y: Multipliers) -> Multipliers:
        """ỹ of y ≠ 0, up to a factor."""
        used = self.rows[y != 0.0]
        return _shifted(y / np.abs(y).max(), self.rows - int(used.max(initial=0)))


def flatten(problem: DirectionProblem) -> Flat | SpanFlat:
    """The problem where M = I, in its units; found once."""
    known: tuple[tuple[Any, ...], Flat | SpanFlat] | None = vars(problem).get("_flat")
    given = (problem.gradient, problem.jacobian, problem.bound, problem.equality, problem.metric, problem.radius)
    if known is None or not all(old is new for old, new in zip(known[0], given, strict=True)):
        by_product = isinstance(problem.whitening, OperatorMetric)
        known = given, SpanFlat.of(problem) if by_product else _flatten(problem)
        vars(problem)["_flat"] = known
    return known[1]


def _flatten(problem: DirectionProblem) -> Flat:
    M, whitening = problem.metric, problem.whitening
    columns = np.zeros(problem.n, np.int64)
    if M is not None:
        columns = balancing_exponents(M if M.ndim == 1 else M.diagonal())
    rows = _largest_exponents(problem.jacobian, columns)
    [strength] = _largest_exponents(problem.gradient[None], columns).tolist()
    length = _length(problem, rows, strength if problem.gradient.any() else None)
    force = length if problem.radius is None else strength
    units = DirectionProblem.trusted(
        _shifted(problem.gradient, columns - force),
        _shifted(problem.jacobian, columns - rows[:, None]),
        _shifted(problem.bound, -rows - length),
        problem.equality,
    )
    if whitening is not None:
        _set_metric(units, M, whitening, columns)
    flat = euclidean(units)
    if problem.radius is not None:
        flat = flat if flat is not units else DirectionProblem.trusted(*_arrays(units))
        object.__setattr__(flat, "radius", float(_shifted(np.array(problem.radius), -length)))
    return Flat(flat, units, columns, rows, length, force)


def _arrays(problem: DirectionProblem) -> tuple[np.ndarray, ...]:
    return problem.gradient, problem.jacobian, problem.bound, problem.equality


def _set_metric(units: DirectionProblem, M: Metric, whitening: Whitening, columns: Int[np.ndarray, "n"]) -> None:
    is_vector = M.ndim == 1
    factor = _shifted(whitening.factor, columns if is_vector else columns[:, None])
    scaled = read_only(_shifted(M, 2 * columns if is_vector else columns + columns[:, None]))
    vars(units).update(metric=scaled, whitening=Whitening(factor, whitening.correction))


def _length(problem: DirectionProblem, rows: Int[np.ndarray, "m"], strength: int | None) -> int:
    """s: of the radius; without one, of the larger of g and what the bounds demand."""
    if problem.radius is not None:
        return int(np.frexp(problem.radius)[1])
    demands = np.isfinite(problem.bound) & (problem.bound != 0.0) & (problem.equality | (problem.bound > 0.0))
    sizes = (np.frexp(problem.bound)[1] - rows)[demands].tolist()
    return max(sizes if strength is None else [strength, *sizes], default=0)


def _largest_exponents(rows: Float[np.ndarray, "m n"], shift: Int[np.ndarray, "n"]) -> Int[np.ndarray, "m"]:
    """Exponent of the largest |row · 2^shift|; 0 for a row of zeros."""
    none = np.iinfo(np.int64).min
    exponents = np.where(rows != 0.0, np.frexp(rows)[1] + shift, none).max(axis=1, initial=none)
    return np.asarray(np.where(exponents == none, 0, exponents))


def _shifted(values: np.ndarray, exponents: int | Int[np.ndarray, "*k"]) -> np.ndarray:
    """values · 2^exponents; infinite or 0 where that over- or underflows."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        return np.asarray(np.ldexp(values, exponents), order="C")
