"""Units in which the numbers of a problem are about 1: powers of two, so that nothing is rounded.

    M̃ = DMD,   d = 2^s D d̃,   g̃ = 2^−f Dg,   J̃ᵢ = 2^−kᵢ JᵢD,   b̃ᵢ = 2^−(kᵢ+s) bᵢ,   μᵢ = 2^(f−kᵢ) μ̃ᵢ,   κ = 2^(f−s) κ̃

with D = diag(2^eⱼ) and ¼ ≤ M̃ⱼⱼ < 1, D = I without a metric; the largest entry of g̃ and of each J̃ᵢ is below 1 and at
least ½. Without a radius f = s; with one 2^s is the radius's. What underflows here is less than 1e-300 of what it is
compared with; whitening the problem as it was given could lose all of a row or of g.
"""

from dataclasses import dataclass

import numpy as np

from .arrays import Float, Int, Multipliers, Vector
from .metric import Metric, Whitening, balancing_exponents
from .problem import DirectionProblem
from .validation import read_only


@dataclass(frozen=True, eq=False)
class Units:
    """The problem of (M̃, g̃, J̃, b̃) and the exponents of the module's head: columns e (n,), rows k (m,), s and f."""

    problem: DirectionProblem
    columns: Int[np.ndarray, "n"]
    rows: Int[np.ndarray, "m"]
    length: int
    force: int

    def inside(self, d: Vector, mu: Multipliers, kappa: float) -> tuple[Vector, Multipliers, float]:
        """(d̃, μ̃, κ̃) of (d, μ, κ)."""
        return (
            _shifted(d, -self.columns - self.length),
            _shifted(mu, self.rows - self.force),
            float(_shifted(np.array(kappa), self.length - self.force)),
        )

    def outside(self, d: Vector, mu: Multipliers, kappa: float) -> tuple[Vector, Multipliers, float]:
        """(d, μ, κ) of (d̃, μ̃, κ̃)."""
        return (
            _shifted(d, self.columns + self.length),
            _shifted(mu, self.force - self.rows),
            float(_shifted(np.array(kappa), self.force - self.length)),
        )

    def proof(self, y: Multipliers) -> Multipliers:
        """ỹ of y ≠ 0, up to a factor."""
        used = self.rows[y != 0.0]
        return _shifted(y / np.abs(y).max(), self.rows - int(used.max(initial=0)))


def in_units(problem: DirectionProblem, direction: Vector | None = None) -> Units:
    """The problem in its units.

    Without a radius the unit of length is that of the longer of g and the given direction, so that both are about 1; of
    g and of what the bounds demand where no direction is given.
    """
    M = problem.metric
    columns = np.zeros(problem.n, np.int64)
    if M is not None:
        columns = balancing_exponents(M if M.ndim == 1 else M.diagonal())
    rows = _largest_exponents(problem.jacobian, columns)
    strength = _largest_exponent(problem.gradient, columns)
    length = _length(problem, (columns, rows), strength, direction)
    force = length if problem.radius is None else (strength or 0)
    scaled = DirectionProblem.trusted(
        _shifted(problem.gradient, columns - force),
        _shifted(problem.jacobian, columns - rows[:, None]),
        _shifted(problem.bound, -rows - length),
        problem.equality,
    )
    if M is not None:
        _set_metric(scaled, M, problem.whitening, columns)
    if problem.radius is not None:
        object.__setattr__(scaled, "radius", float(_shifted(np.array(problem.radius), -length)))
    return Units(scaled, columns, rows, length, force)


def _set_metric(
    scaled: DirectionProblem, M: Metric, whitening: Whitening | None, columns: Int[np.ndarray, "n"]
) -> None:
    units = 2 * columns if M.ndim == 1 else columns + columns[:, None]
    object.__setattr__(scaled, "metric", read_only(_shifted(M, units)))
    if whitening is not None:
        factor = whitening.factor
        factor = _shifted(factor, columns if factor.ndim == 1 else columns[:, None])
        object.__setattr__(scaled, "whitening", Whitening(factor, whitening.correction))


def _length(
    problem: DirectionProblem,
    exponents: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
    strength: int | None,
    direction: Vector | None,
) -> int:
    columns, rows = exponents
    if problem.radius is not None:
        return int(np.frexp(problem.radius)[1])
    if direction is not None:
        other = _largest_exponent(direction, -columns)
    else:
        demands = np.isfinite(problem.bound) & (problem.equality | (problem.bound > 0.0))
        other = _largest_exponent(problem.bound[demands], -rows[demands])
    return max((each for each in (strength, other) if each is not None), default=0)


def _largest_exponent(values: Float[np.ndarray, "k"], shift: Int[np.ndarray, "k"]) -> int | None:
    """Exponent of the largest |values · 2^shift|; None where all are 0."""
    exponents = (np.frexp(values)[1] + shift)[values != 0.0]
    return int(exponents.max()) if exponents.size else None


def _largest_exponents(rows: Float[np.ndarray, "m n"], shift: Int[np.ndarray, "n"]) -> Int[np.ndarray, "m"]:
    """The same for each row; 0 for a row of zeros."""
    none = np.iinfo(np.int64).min
    exponents = np.where(rows != 0.0, np.frexp(rows)[1] + shift, none).max(axis=1, initial=none)
    return np.asarray(np.where(exponents == none, 0, exponents))


def _shifted(values: np.ndarray, exponents: int | Int[np.ndarray, "*k"]) -> np.ndarray:
    """values · 2^exponents; infinite or 0 where that over- or underflows."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        return np.asarray(np.ldexp(values, exponents), order="C")
