"""What there is to see of an answer (d, μ, κ), in whatever geometry: all that the referee measures.

    r = κMd − g − Jᵀμ,     Jᵢd − bᵢ,     ‖g‖,     √(dᵀMd)        κ = 1 without a radius

A metric M = LLᵀ is a change of coordinates, Lᵀd, L⁻¹g and JL⁻ᵀ, in units where all numbers are about 1 (see `flat`).
What float64 does not tell is formed as if in twice the precision. Two things ask for it. In a full metric up to cond(M)
of the parts cancel: M itself is used, and L only to measure what is left, so that rounding of L hides no error. With
multipliers μ̂ᵢ = 1e10 float64 leaves 1e-6 in r, where an error of d could hide.
Source: Wilkinson 1963, Rounding Errors in Algebraic Processes (the residual in twice the precision).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import Float, Jacobian, Multipliers, Vector
from .compensated import products
from .flat import Flat, flatten
from .problem import DirectionProblem
from .scaling import UnitRows, norm, unit_rows
from .vectors import Certificate

# Lengths of vectors whose squares, and sums of these, neither over- nor underflow: 1e±154 would, for one number.
_SAFE_LENGTH = (1e-140, 1e140)
_BLOCK = 8192  # numbers of each vector at a time: the dozen arrays that a product in pairs takes stay in a cache


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is seen of an answer to the problem, which may be in units of its own; where M = I.

    mu: μ; kappa: κ, 1 without a radius; rest: ‖r‖, r = κMd − g − Jᵀμ; strength: ‖g‖; length: ‖d‖; rows: Ĵ; bound: b̂;
    slack: Ĵd − b̂; exact: r and d, (n,), where they are known in twice the precision.
    """

    problem: DirectionProblem
    mu: Multipliers
    kappa: float
    rest: float
    strength: float
    length: float
    rows: UnitRows
    bound: Multipliers
    slack: Multipliers
    exact: tuple[Vector, Vector] | None = None


def ways_to_look(problem: DirectionProblem) -> tuple[Any, ...]:
    """Functions that look at (d, μ, κ), the quickest first; each is None where it sees nothing."""
    if problem.metric is None:
        if problem.is_tree and not problem.vectors.has_rows:
            return (look_in_passes,)  # there is no other way
        return (look_in_passes, _look, _look_closely) if problem.is_long else (_look, _look_closely)
    if callable(problem.metric):
        return (_look_by_products,)
    return (_look_in_units, _look_closely) if problem.metric.ndim == 1 else (_look_closely,)


def look_in_passes(problem: DirectionProblem, d: Any, mu: Multipliers, kappa: float) -> Evidence | None:
    """Over long vectors as they are, d in the form of g; at nothing where a square leaves float64."""
    lengths, certificate = problem.vectors.lengths(), problem.vectors.certificate(d, mu, kappa)
    sizes = [each for i, each in enumerate(lengths.tolist()) if each > 0.0 or not problem.vectors.is_zero(i)]
    is_some = certificate.length > 0.0 or (problem.vectors.has_rows and problem.row_of(d).any())
    sizes += [certificate.length] if is_some else []
    if not (_SAFE_LENGTH[0] < min(sizes, default=1.0) and max(sizes, default=1.0) < _SAFE_LENGTH[1]):
        return None
    return read_certificate(certificate, problem, mu, kappa, lengths)


def read_certificate(
    certificate: Certificate,
    problem: DirectionProblem,
    mu: Multipliers,
    kappa: float,
    lengths: Float[np.ndarray, "channels"],
) -> Evidence:
    """Of long vectors; lengths: of g and of each row."""
    rows = UnitRows(np.empty((problem.m, 0)), lengths[1:], np.ones(problem.m))
    bound, slack = rows.per_length(problem.bound), rows.per_length(certificate.products - problem.bound)
    return Evidence(problem, mu, kappa, certificate.rest, float(lengths[0]), certificate.length, rows, bound, slack)


def _look(
    problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float, rows: UnitRows | None = None
) -> Evidence | None:
    """In float64, where M = I; rows: Ĵ, where it is known."""
    rows = unit_rows(problem.jacobian) if rows is None else rows
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        g, J, bound = problem.gradient, problem.jacobian, rows.per_length(problem.bound)
        slack = rows.jacobian @ d - bound
        return Evidence(problem, mu, kappa, norm(kappa * d - g - mu @ J), norm(g), norm(d), rows, bound, slack)


def _look_in_units(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float) -> Evidence | None:
    """In float64, the metric being one of units."""
    flat: Any = flatten(problem)
    if flat.failure is not None:
        return None
    mu, kappa = flat.in_units(d, mu, kappa)[1:]
    return _look(flat.problem, flat.inside(d), mu, kappa, flat.unit)


def _look_closely(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float) -> Evidence | None:
    """As if in twice the precision; in a full metric by M itself."""
    flat: Any = flatten(problem)
    if flat.failure is not None:
        return None
    d, mu, kappa = flat.in_units(d, mu, kappa)
    problem, rows, L = flat.problem, flat.unit, flat.whitening
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        x = d if L is None else L.direction(d)
        if L is not None and L.factor.ndim == 2:
            rest, length, slack = _find_terms(flat, d, mu, kappa)
            rest, (bound, slack) = L.rows(rest), rows.per_length(np.array([problem.bound, slack]))
        else:
            rest, length = _find_rest(problem.gradient, problem.jacobian, x, mu, kappa), norm(x)
            bound = rows.per_length(problem.bound)
            slack = rows.jacobian @ x - bound
        g = problem.gradient  # whose numbers are about 1
        sizes = math.sqrt(rest @ rest), math.sqrt(g @ g), length
        return Evidence(problem, mu, kappa, *sizes, rows, bound, slack, (rest, x))


def _look_by_products(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float) -> Evidence | None:
    """By an operator's M itself, in float64: as exact as the products are."""
    flat: Any = flatten(problem)
    if flat.failure is not None or not (np.isfinite(d).all() and np.isfinite(mu).all() and math.isfinite(kappa)):
        return None
    Md, span, rows = flat.whitening.metric.times(d), flat.whitening, flat.unit
    rest = span.of_force(kappa * Md - problem.gradient - mu @ problem.jacobian)
    x, slack = span.coordinates(d, Md), problem.jacobian @ d - problem.bound
    problem, bound, slack = flat.problem, rows.per_length(problem.bound), rows.per_length(slack)
    return Evidence(problem, mu, kappa, norm(rest), norm(problem.gradient), norm(x), rows, bound, slack, (rest, x))


def _find_rest(g: Vector, J: Jacobian, d: Vector, mu: Multipliers, kappa: float) -> Vector:
    """κd − g − Jᵀμ, each number to 2⁻¹⁰⁰ or so of the largest of its terms."""
    on, rest = mu != 0.0, np.empty_like(g)
    weights, J = np.append([kappa, -1.0], -mu[on]), J if on.all() else J[on]
    for start in range(0, len(g), _BLOCK):
        part = slice(start, start + _BLOCK)
        rest[part] = products(np.vstack([d[part], g[part], J[:, part]]).T, weights).rounded()
    return rest


def _find_terms(flat: Flat, d: Vector, mu: Multipliers, kappa: float) -> tuple[Vector, float, Multipliers]:
    """κMd − g − Jᵀμ, √(dᵀMd) and Jd − b, infinite where a row is off; all in units, M: (n, n)."""
    bound, n, e = flat.problem.bound, len(d), flat.columns
    is_off = bound == -np.inf
    given = np.vstack([np.ldexp(flat.metric, e + e[:, None]), flat.given[1:]])
    last = np.concatenate([np.zeros(n), np.where(is_off, 0.0, -bound)])
    hi, lo = products(np.column_stack([given, last]), np.append(d, 1.0))
    slack = np.where(is_off, np.inf, hi[n:] + lo[n:])
    square = float(products(np.concatenate([hi[:n], lo[:n]])[None], np.append(d, d)).hi[0])
    pushed = products(np.column_stack([hi[:n], lo[:n], flat.given.T]), np.concatenate([[kappa, kappa, -1.0], -mu]))
    return pushed.hi + pushed.lo, math.sqrt(square) if square > 0.0 else 0.0, slack
