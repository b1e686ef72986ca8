"""The referee: optimality residuals from the problem's data, whatever a back end reports.

With unit rows Ĵᵢ = Jᵢ/‖Jᵢ‖, b̂ᵢ = bᵢ/‖Jᵢ‖, μ̂ᵢ = μᵢ‖Jᵢ‖ and σ = max(‖g‖, ‖d‖):

    primal           max (b̂ᵢ − Ĵᵢd)₊ / σ  on I,   max |b̂ᵢ − Ĵᵢd| / σ  on E
    dual             max (−μ̂ᵢ)₊ / σ  on I
    complementarity  max |min(μ̂ᵢ, Ĵᵢd − b̂ᵢ)| / σ  on I
    stationarity     (‖d − g − Jᵀμ‖ − min(8·eps·Σ|μ̂ᵢ|, 1e-5·σ))₊ / σ

The allowance is for what μ itself loses in float64. Where it exceeds 1e-13·σ, the rest is formed in twice the
precision, and only its part in the span of the rows is allowed anything: see `stationarity`. With g = d = 0 there is no
σ: primal is then infinite or 0, and the others are 0.

In a metric M = LLᵀ all of it is measured where M = I: on Lᵀd, L⁻¹g and JL⁻ᵀ, with the same μ. Lengths of directions
are then √(dᵀMd), those of gradients and rows √(gᵀM⁻¹g), whatever L and whatever the units of single parameters, and
stationarity is Md − g − Jᵀμ, formed with M itself and only then measured by L⁻¹ (see `exact_terms`).

In a ball of the given radius g is no direction: its length says nothing about d's, and there are two units. Forces (g,
μ̂ᵢ, κ‖d‖) are measured by γ = ‖g‖ (the largest force where g = 0), lengths (d, b̂ᵢ, radius) by λ, the larger of ‖d‖ and
the smallest length that the problem names: the radius or any |b̂ᵢ| ≠ 0. So neither a huge radius nor a huge slack bound
lets a violation pass, and d = 1e-20 for 0 is no violation. The ball is one more constraint, with the unit inward normal
−d/‖d‖, the slack radius − ‖d‖ and the multiplier κ̂ = κλ:

    primal           max of (b̂ᵢ − Ĵᵢd)₊ / λ on I, |b̂ᵢ − Ĵᵢd| / λ on E, (‖d‖ − radius)₊ / λ
    dual             max of (−μ̂ᵢ)₊ / γ on I, (−κ̂)₊ / γ
    complementarity  max of |min(μ̂ᵢ/γ, (Ĵᵢd − b̂ᵢ)/λ)| on I, |min(κ̂/γ, (radius − ‖d‖)/λ)|
    stationarity     (‖κd − g − Jᵀμ‖ − min(8·eps·(Σ|μ̂ᵢ| + |κ̂|), 1e-5·γ))₊ / γ

Nocedal & Wright, Numerical Optimization, Theorem 12.1; without a radius they are sufficient, the problem being strictly
convex. With one they are sufficient too, the problem being convex; but which of several optima it is they do not say.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from .arrays import Float, Mask, Multipliers, Vector
from .direction import KKTResiduals as KKTResiduals
from .exact_terms import exact_terms
from .problem import DirectionProblem, euclidean, lengths, unit_rows
from .stationarity import beyond_rounding, exact_rest
from .units import in_units
from .validation import real_values, require_shape
from .vectors import Certificate, is_long

_EPS = float(np.finfo(np.float64).eps)
# What rounding leaves of b̂ᵀŷ − radius ‖Ĵᵀŷ‖, in units of max(|b̂|, radius) Σ|ŷ|.
_ROUNDED_GAIN = 8 * _EPS
# A violation of 1e-9 has seven digits, so its certificate is this good at worst; sizeable violations reach 1e-15.
FARKAS_TOLERANCE = 1e-6
_SAFE_LENGTH = (1e-140, 1e140)  # of vectors whose squares neither over- nor underflow
# Allowance from which on r is formed in twice the precision, and its part outside the span of the rows allowed nothing:
# a tenth of the smallest tolerance that anybody asks for.
_DOUBTFUL = 1e-13
_ALLOWED = 1e-5  # most that rounding of μ is allowed of the stationarity, in its unit


@runtime_checkable
class HasValueAndMultipliers(Protocol):
    """All that the referee reads of an answer; and `radius_multiplier`, 0 where it has none."""

    @property
    def value(self) -> Any:
        """d, (n,)."""

    @property
    def multipliers(self) -> Any:
        """μ, (m,)."""


_HOPELESS = KKTResiduals(np.inf, np.inf, np.inf, np.inf)


def kkt_residuals(problem: DirectionProblem, direction: HasValueAndMultipliers) -> KKTResiduals:
    """Residuals of (d, μ) = (direction.value, direction.multipliers) as the module's head defines them.

    Free of the scale of g, of J and of each row. Raises ValueError when value or multipliers have a wrong shape.
    """
    d, mu = real_values("direction.value", direction.value), real_values("direction.multipliers", direction.multipliers)
    require_shape("direction.value", d, (problem.n,))
    require_shape("direction.multipliers", mu, (problem.m,))
    if problem.metric is not None or problem.radius is not None:
        kappa = 0.0 if problem.radius is None else float(getattr(direction, "radius_multiplier", 0.0))
        return _residuals_in_geometry(problem, d, mu, kappa)
    if is_long(problem.m, problem.n):
        return _long_residuals(problem, d, mu)
    return _euclidean_residuals(problem, d, mu)


def _long_residuals(problem: DirectionProblem, d: Vector, multipliers: Multipliers) -> KKTResiduals:
    """In passes over the vectors as they are; as `_euclidean_residuals` where a square leaves float64."""
    lengths, certificate = problem.vectors.lengths(), problem.vectors.certificate(d, multipliers)
    sizes = [each for i, each in enumerate(lengths.tolist()) if each > 0.0 or not problem.vectors.is_zero(i)]
    sizes += [certificate.length] if certificate.length > 0.0 or d.any() else []
    with np.errstate(over="ignore", invalid="ignore"):
        allowance = 8 * _EPS * _total(multipliers * lengths[1:]) / (max(lengths[0], certificate.length) or 1.0)
    are_safe = _SAFE_LENGTH[0] < min(sizes, default=1.0) and max(sizes, default=1.0) < _SAFE_LENGTH[1]
    if not (are_safe and allowance < _DOUBTFUL):
        return _euclidean_residuals(problem, d, multipliers)
    return certified_residuals(certificate, problem, multipliers, lengths)


def _euclidean_residuals(problem: DirectionProblem, d: Vector, multipliers: Multipliers) -> KKTResiduals:
    if not (np.isfinite(d).all() and np.isfinite(multipliers).all()):
        return _HOPELESS
    # The largest entry first: σ itself may overflow.
    unit = max(_largest(np.abs(problem.gradient)), _largest(np.abs(d)))
    rows = unit_rows(problem.jacobian)
    bound = rows.per_length(problem.bound)
    if unit == 0.0:  # g = d = 0: nothing to be relative to
        violated = np.where(problem.equality, bound != 0, bound > 0).any()
        return KKTResiduals(0.0, np.inf if violated else 0.0, 0.0, 0.0)
    with np.errstate(over="ignore"):
        bound, mu = bound / unit, rows.times_length(multipliers, unit)
    if not np.isfinite(mu).all():  # overflows in units of σ
        return _HOPELESS
    return _relative_residuals(
        problem,
        rows.jacobian,
        (bound, mu),
        (d / unit, problem.gradient / unit),
        lambda: exact_rest(problem, d, multipliers, 1.0, unit),
    )


def _relative_residuals(
    problem: DirectionProblem,
    jacobian: np.ndarray,
    bound_and_multipliers: tuple[Multipliers, Multipliers],
    d_and_gradient: tuple[Vector, Vector],
    in_pairs: Callable[[], Vector],
) -> KKTResiduals:
    sigma = max(_norm(each) for each in d_and_gradient)
    d, g = (each / sigma for each in d_and_gradient)
    bound, mu = (each / sigma for each in bound_and_multipliers)
    slack = jacobian @ d - bound
    allowance = 8 * _EPS * _total(mu)
    if allowance < _DOUBTFUL:
        return _judged(slack, mu, max(_norm(d - g - mu @ jacobian) - allowance, 0.0), problem.equality)
    rest = beyond_rounding(in_pairs() / sigma, jacobian[mu != 0.0], min(allowance, _ALLOWED))
    return _judged(slack, mu, rest, problem.equality)


def _judged(slack: Multipliers, mu: Multipliers, stationarity: float, equality: Mask) -> KKTResiduals:
    """Of Ĵd − b̂ and μ̂, in units of σ."""
    inequality = ~equality
    return KKTResiduals(
        stationarity=stationarity,
        primal=_largest(np.where(inequality, np.maximum(-slack, 0.0), np.abs(slack))),
        dual=_largest(np.maximum(-mu[inequality], 0.0)),
        complementarity=_largest(np.abs(np.minimum(mu, slack))[inequality]),
    )


def certified_residuals(
    certificate: Certificate,
    problem: DirectionProblem,
    multipliers: Multipliers,
    lengths: Float[np.ndarray, "channels"],
) -> KKTResiduals:
    """The residuals of a certificate; infinite where a number leaves float64, or μ is too large to tell.

    Of a d that was combined of the vectors themselves, or with small multipliers: what rounding of μ is allowed is not
    split into what lies in the span of the rows and what does not. lengths: of g and of each row, 0 for what is 0 or
    off.
    """
    sigma = max(float(lengths[0]), certificate.length)
    numbers = (sigma, certificate.length, certificate.rest, *certificate.products)
    if not all(abs(each) < np.inf for each in numbers):
        return _HOPELESS
    if sigma == 0.0:  # g = d = 0: nothing to be relative to
        violated = np.where(problem.equality, problem.bound != 0.0, problem.bound > 0.0).any()
        return KKTResiduals(0.0, np.inf if violated else 0.0, 0.0, 0.0)
    is_zero = (lengths[1:] == 0.0) & (problem.bound > -np.inf)  # rows that no d can change
    rows = np.where(lengths[1:] > 0.0, lengths[1:], 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        mu = np.where(is_zero, 0.0, multipliers * rows / sigma)
        slack = (certificate.products - problem.bound) / rows / sigma
    asks = is_zero & (problem.bound != 0.0)
    slack[asks] = np.where(problem.equality | (problem.bound > 0.0), -np.inf, np.inf)[asks]
    allowance = 8 * _EPS * _total(mu)
    if not allowance < _ALLOWED:
        return _HOPELESS
    return _judged(slack, mu, max(certificate.rest / sigma - allowance, 0.0), problem.equality)


def _residuals_in_geometry(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float) -> KKTResiduals:
    """In the coordinates where M = I, and in units that neither over- nor underflow there."""
    if not (np.isfinite(d).all() and np.isfinite(mu).all() and np.isfinite(kappa)):
        return _HOPELESS
    if problem.metric is not None:
        units = in_units(problem, d)
        problem, d, mu, kappa = units.problem, *units.inside(d, mu, kappa)
        if not (np.isfinite(d).all() and np.isfinite(mu).all() and np.isfinite(kappa)):
            return _HOPELESS
        if problem.metric is not None and problem.metric.ndim == 2:
            return _residuals_in_full_metric(problem, d, mu, kappa)
        d = d if problem.whitening is None else problem.whitening.direction(d)
    flat = euclidean(problem)
    if problem.radius is None:
        return _euclidean_residuals(flat, d, mu)
    return _residuals_in_ball(flat, d, (mu, kappa), problem.radius)


def _residuals_in_full_metric(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float) -> KKTResiduals:
    """With M itself: what LLᵀ ≠ M of a rounded factor makes wrong is seen."""
    in_ball, inequality = problem.radius is not None, ~problem.equality
    exact = exact_terms(problem, d, mu, kappa if in_ball else 1.0)
    unit = gamma = max(exact.strength, exact.length)
    room, force = np.inf, 0.0
    if unit == 0.0:  # g = d = 0
        return _euclidean_residuals(euclidean(problem), d, mu)
    if problem.radius is not None:
        bound = exact.rows.per_length(problem.bound)
        named = np.abs(bound[(bound != 0) & np.isfinite(bound)])
        unit = max(exact.length, float(named.min(initial=problem.radius)))
        gamma = exact.strength or max(_largest(np.abs(exact.rows.times_length(mu))), abs(kappa) * unit) or 1.0
        room, force = (problem.radius - exact.length) / unit, kappa / gamma * unit
    mu, slack = exact.rows.times_length(mu, gamma), exact.slack / unit
    if not (np.isfinite(mu).all() and np.isfinite(exact.rest).all() and np.isfinite(force)):
        return _HOPELESS
    allowance = min(8 * _EPS * (_total(mu) + abs(force)), _ALLOWED)
    if allowance < _DOUBTFUL:
        rest = max(_norm(exact.rest) / gamma - allowance, 0.0)
    else:
        whitened = problem.whitening.direction(d) if problem.whitening is not None else d
        span = [exact.rows.jacobian[mu != 0.0], whitened / (_norm(whitened) or 1.0)]
        rest = beyond_rounding(exact.rest / gamma, np.vstack(span if force != 0.0 else span[:1]), allowance)
    return KKTResiduals(
        stationarity=rest,
        primal=max(_largest(np.where(inequality, np.maximum(-slack, 0.0), np.abs(slack))), -room, 0.0),
        dual=max(_largest(np.maximum(-mu[inequality], 0.0)), -force, 0.0),
        complementarity=max(_largest(np.abs(np.minimum(mu, slack))[inequality]), abs(min(force, room))),
    )


def _residuals_in_ball(
    problem: DirectionProblem, d: Vector, forces: tuple[Multipliers, float], radius: float
) -> KKTResiduals:
    rows = unit_rows(problem.jacobian)
    bound = rows.per_length(problem.bound)
    named = np.abs(bound[(bound != 0) & np.isfinite(bound)])
    unit = max(_norm(d), float(named.min(initial=radius)))
    with np.errstate(over="ignore", invalid="ignore"):
        mu, kappa = rows.times_length(forces[0]), forces[1] * unit
        gamma = _norm(problem.gradient) or max(_largest(np.abs(mu)), abs(kappa)) or 1.0
        mu, kappa = rows.times_length(forces[0], gamma), forces[1] / gamma * unit
        direction, d, bound, g = d, d / unit, bound / unit, problem.gradient / gamma
        slack, room = rows.jacobian @ d - bound, radius / unit - _norm(d)
    if not (np.isfinite(mu).all() and np.isfinite(kappa) and np.isfinite(g).all() and np.isfinite(d).all()):
        return _HOPELESS
    inequality = ~problem.equality
    allowance = 8 * _EPS * (_total(mu) + abs(kappa))
    if allowance < _DOUBTFUL:
        rest = max(_norm(kappa * d - g - mu @ rows.jacobian) - allowance, 0.0)
    else:
        span = np.vstack([rows.jacobian[mu != 0.0], d / (_norm(d) or 1.0) if kappa != 0.0 else 0.0 * d])
        exact = exact_rest(problem, direction, forces[0], forces[1], gamma)
        rest = beyond_rounding(exact, span, min(allowance, _ALLOWED))
    return KKTResiduals(
        stationarity=rest,
        primal=max(_largest(np.where(inequality, np.maximum(-slack, 0.0), np.abs(slack))), -room, 0.0),
        dual=max(_largest(np.maximum(-mu[inequality], 0.0)), -kappa, 0.0),
        complementarity=max(_largest(np.abs(np.minimum(mu, slack))[inequality]), abs(min(kappa, room))),
    )


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
    size = max(_norm(lack.amount), 1e-9 * _violation_unit(problem, d, lack))
    return _norm(lack.amount / size @ lack.jacobian) if size > 0 else 0.0


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
    return _norm(lack.amount / unit @ lack.jacobian) if unit > 0 else 0.0


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
    return max(_norm(problem.gradient), _norm(d), _largest(required))


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
    force, negative = _norm(weights @ rows.jacobian), _largest(np.maximum(-weights[~problem.equality], 0.0))
    largest = float(np.abs(bound[weights != 0]).max())
    gain = float((bound / largest) @ weights) if largest > 0 else 0.0
    residual = max(force, negative) / gain if gain > 0 else float("inf")
    if problem.radius is None or not largest > 0:
        return residual
    unit = max(largest, problem.radius)
    gain = float((bound / unit) @ weights) - problem.radius / unit * force
    rounded = _ROUNDED_GAIN * float(np.abs(weights).sum())
    return min(residual, max(rounded, negative) / gain if gain > 0 else float("inf"))


def is_proven(problem: DirectionProblem, answer: HasValueAndMultipliers) -> bool:
    """Whether the multipliers prove that nothing meets the constraints, and the value violates them least."""
    return (
        farkas_residual(problem, answer.multipliers) <= FARKAS_TOLERANCE
        and least_violation_residual(problem, answer.value) <= FARKAS_TOLERANCE
    )


def _zero_row_impossible(problem: DirectionProblem, y: Multipliers) -> Mask:
    return np.where(problem.equality, np.sign(problem.bound) * y > 0, problem.bound > 0)


def _norm(vector: np.ndarray) -> float:
    """‖v‖₂, without the overhead of `lengths` where the square neither over- nor underflows."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        square = float(vector @ vector)
    return math.sqrt(square) if 1e-280 < square < 1e280 else float(lengths(vector))


def _total(values: np.ndarray) -> float:
    with np.errstate(over="ignore"):
        return float(np.abs(values).sum())


def _largest(values: np.ndarray) -> float:
    return float(values.max(initial=0.0))
