"""What there is to see of an answer (d, μ, κ), in whatever geometry: all that the referee measures.

    r = κMd − g − Jᵀμ,     Jᵢd − bᵢ,     ‖g‖,     √(dᵀMd)        κ = 1 without a radius

A metric M = LLᵀ is a change of coordinates, Lᵀd, L⁻¹g and JL⁻ᵀ, in units where all numbers are about 1 (see `flat`).
What float64 does not tell is formed as if in twice the precision. Two things ask for it. In a full metric up to cond(M)
of the parts cancel: M itself is used, and L only to measure what is left, so that rounding of L hides no error. With
multipliers μ̂ᵢ = 1e10 float64 leaves 1e-6 in r, where an error of d could hide.
Source: Wilkinson 1963, Rounding Errors in Algebraic Processes (the residual in twice the precision).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .arrays import Float, Jacobian, Multipliers, Vector
from .compensated import products
from .flat import Flat, flatten
from .flat_span import SpanFlat
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


def gather_evidence(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float) -> Iterator[Evidence]:
    """By passes over long vectors, in float64, and as if in twice the precision: until one is enough."""
    if problem.metric is None and problem.is_long:
        yield from _look_in_passes(problem, d, mu, kappa)
    if problem.is_tree and not problem.vectors.has_rows:
        return  # there is no other way to look
    if not (np.isfinite(d).all() and np.isfinite(mu).all() and math.isfinite(kappa)):
        return
    if problem.metric is None:
        yield _look(problem, d, mu, kappa, unit_rows(problem.jacobian))
    flat = flatten(problem)
    if flat.failure is not None:
        return
    mu, kappa = flat.in_units(d, mu, kappa)[1:]
    if isinstance(flat, SpanFlat):
        yield _look_by_products(flat, d, mu, kappa)
        return
    if problem.metric is not None and problem.metric.ndim == 1:
        yield _look(flat.problem, flat.inside(d), mu, kappa, flat.unit)
    yield _look_closely(flat, d, mu, kappa)


def _look_in_passes(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float) -> Iterator[Evidence]:
    """Over the vectors as they are; at nothing where a square leaves float64."""
    lengths, certificate = problem.vectors.lengths(), problem.vectors.certificate(d, mu, kappa)
    sizes = [each for i, each in enumerate(lengths.tolist()) if each > 0.0 or not problem.vectors.is_zero(i)]
    sizes += [certificate.length] if certificate.length > 0.0 or (problem.vectors.has_rows and d.any()) else []
    if _SAFE_LENGTH[0] < min(sizes, default=1.0) and max(sizes, default=1.0) < _SAFE_LENGTH[1]:
        yield read_certificate(certificate, problem, mu, kappa, lengths)


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


def _look(flat: DirectionProblem, d: Vector, mu: Multipliers, kappa: float, rows: UnitRows) -> Evidence:
    """In float64, where M = I."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        g, J, bound = flat.gradient, flat.jacobian, rows.per_length(flat.bound)
        slack = rows.jacobian @ d - bound
        return Evidence(flat, mu, kappa, norm(kappa * d - g - mu @ J), norm(g), norm(d), rows, bound, slack)


def _look_closely(flat: Flat, d: Vector, mu: Multipliers, kappa: float) -> Evidence:
    """As if in twice the precision; in a full metric by M itself. d: as given, μ and κ in units."""
    problem, rows, x, L = flat.problem, flat.unit, flat.inside(d), flat.whitening
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        bound = rows.per_length(problem.bound)
        if L is not None and L.factor.ndim == 2:
            rest, length, slack = _find_terms(flat, d, mu, kappa)
            rest, slack = L.rows(rest), rows.per_length(slack)
        else:
            rest = _find_rest(problem.gradient, problem.jacobian, x, mu, kappa)
            length, slack = norm(x), rows.jacobian @ x - bound
        strength = norm(problem.gradient)
        return Evidence(problem, mu, kappa, norm(rest), strength, length, rows, bound, slack, (rest, x))


def _look_by_products(flat: SpanFlat, d: Vector, mu: Multipliers, kappa: float) -> Evidence:
    """By an operator's M itself, in float64: as exact as the products are."""
    problem, rows = flat.problem, flat.unit
    rest, x, slack = flat.look(d, mu, kappa)
    bound, slack = rows.per_length(problem.bound), rows.per_length(slack)
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
    """κMd − g − Jᵀμ, √(dᵀMd) and Jd − b, infinite where a row is off; in units, M: (n, n)."""
    bound = flat.problem.bound
    n, is_off, d = len(d), bound == -np.inf, flat.in_units(d, mu, kappa)[0]
    given = np.vstack([flat.matrix, flat.given[1:]])
    last = np.concatenate([np.zeros(n), np.where(is_off, 0.0, -bound)])
    hi, lo = products(np.column_stack([given, last]), np.append(d, 1.0))
    slack = np.where(is_off, np.inf, hi[n:] + lo[n:])
    square = float(products(np.concatenate([hi[:n], lo[:n]])[None], np.append(d, d)).hi[0])
    pushed = products(np.column_stack([hi[:n], lo[:n], flat.given.T]), np.concatenate([[kappa, kappa, -1.0], -mu]))
    return pushed.hi + pushed.lo, math.sqrt(square) if square > 0.0 else 0.0, slack
