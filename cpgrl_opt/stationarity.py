"""r = κd − g − Jᵀμ where multipliers are so large that rounding hides an error, and what rounding of μ explains of it.

With μ̂ᵢ = 1e10 float64 leaves errors of 1e-6 in r. So r is formed as if in twice the precision or more, and is split:

    r = r_in + r_out,    r_in in the span of the rows (and of d, where κ ≠ 0)

To change μ in its last digits changes r_in by up to eps Σ|μ̂|, and r_out not at all. So ‖r_in‖ is allowed that much, and
r_out nothing: it is an error of d, whatever μ.
"""

import math
from fractions import Fraction

import numpy as np

from .arrays import Float, Multipliers, Vector
from .compensated import Pair
from .problem import DirectionProblem, lengths

# Beyond it 106 bits leave less than 1e-10 of r: then rational arithmetic, at 10 µs a number.
_MOST_IN_PAIRS = 2.0**60
_MOST_IN_RATIONALS = 100_000
_RANK = 1e-13  # singular values of unit rows below this are rounding


def exact_rest(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float, unit: float) -> Vector:
    """r / unit, (n,), where M = I; infinite where it leaves float64."""
    with np.errstate(over="ignore", invalid="ignore"):
        forces = mu / unit * np.abs(problem.jacobian).max(axis=1, initial=0.0)
    if np.abs(forces).max(initial=0.0) < _MOST_IN_PAIRS:
        return _rest_in_pairs(problem, d, mu, kappa, unit)
    if problem.jacobian.size > _MOST_IN_RATIONALS:  # minutes, for what no solver that is right answers
        return np.full(problem.n, np.inf)
    return _rest_in_rationals(problem, d, mu, kappa, unit)


def _rest_in_pairs(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float, unit: float) -> Vector:
    """Each number to 2⁻¹⁰⁰ or so of the largest of its terms."""
    exponent, rows = math.frexp(unit)[1], np.frexp(np.abs(problem.jacobian).max(axis=1, initial=0.0))[1]
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        size = int(np.frexp(np.abs(d).max(initial=0.0))[1])
        rest = _times(np.ldexp(problem.gradient, -exponent), -1.0)
        rest = rest.plus(_times(np.ldexp(d, -size), float(np.ldexp(kappa, size - exponent))))
        for row, shift, force in zip(problem.jacobian, rows, mu, strict=True):
            if force != 0.0:
                rest = rest.plus(_times(np.ldexp(row, -shift), -float(np.ldexp(force, int(shift) - exponent))))
        return rest.rounded() / math.frexp(unit)[0]


def _rest_in_rationals(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float, unit: float) -> Vector:
    """Without rounding until the end."""
    forces, rest = [Fraction(each) for each in mu], np.empty(problem.n)
    for j in range(problem.n):
        pulled = sum(force * Fraction(row[j]) for force, row in zip(forces, problem.jacobian, strict=True))
        exact = (Fraction(kappa) * Fraction(d[j]) - Fraction(problem.gradient[j]) - pulled) / Fraction(unit)
        rest[j] = float(exact) if abs(exact) < 2**1000 else math.inf
    return rest


def beyond_rounding(rest: Vector, rows: Float[np.ndarray, "k n"], allowance: float) -> float:
    """√(‖r_out‖² + (‖r_in‖ − allowance)₊²), the rows being those that r may be changed along, each of length 1 or 0."""
    if not np.isfinite(rest).all():
        return math.inf
    _, values, basis = np.linalg.svd(rows, full_matrices=False)
    coordinates = basis[values > _RANK] @ rest
    outside = float(lengths(rest - coordinates @ basis[values > _RANK]))
    return math.hypot(outside, max(float(lengths(coordinates)) - allowance, 0.0))


def _times(vector: Vector, factor: float) -> Pair:
    return Pair(vector, np.zeros_like(vector)).times(factor)
