"""The referee: optimality residuals from the problem's data, whatever a back end reports.

With unit rows Ĵᵢ = Jᵢ/‖Jᵢ‖, b̂ᵢ = bᵢ/‖Jᵢ‖, μ̂ᵢ = μᵢ‖Jᵢ‖ and σ = max(‖g‖, ‖d‖):

    primal           max (b̂ᵢ − Ĵᵢd)₊ / σ  on I,   max |b̂ᵢ − Ĵᵢd| / σ  on E
    dual             max (−μ̂ᵢ)₊ / σ  on I
    complementarity  max |min(μ̂ᵢ, Ĵᵢd − b̂ᵢ)| / σ  on I
    stationarity     (‖d − g − Jᵀμ‖ − min(8·eps·Σ|μ̂ᵢ|, 1e-5·σ))₊ / σ

The allowance is for what μ itself loses in float64. Where it exceeds 1e-13·σ, the rest is formed in twice the
precision, and only its part in the span of the rows is allowed anything: see `_exact_rest`. With g = d = 0 there is no
σ: primal is then infinite or 0, and the others are 0.

In a metric M = LLᵀ all of it is measured where M = I: on Lᵀd, L⁻¹g and JL⁻ᵀ, with the same μ. Lengths of directions
are then √(dᵀMd), those of gradients and rows √(gᵀM⁻¹g), whatever L and whatever the units of single parameters, and
stationarity is Md − g − Jᵀμ, formed with M itself and only then measured by L⁻¹.

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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ._exact_rest import find_rest, find_terms, split_rest
from ._violation import (
    FARKAS_TOLERANCE,
    excess_violation,
    farkas_residual,
    is_out_of_reach,
    largest,
    least_violation_residual,
    misses_a_bound,
    norm,
    proof_tolerance,
    violation,
    violation_tolerance,
)
from .arrays import Float, Multipliers, Vector
from .compensated import Pair
from .direction import Direction, KKTResiduals, Status
from .problem import DirectionProblem
from .scaling import UnitRows, unit_rows
from .units import in_units
from .validation import real_values, require_shape
from .vectors import Certificate

__all__ = [
    "HasValueAndMultipliers",
    "KKTResiduals",
    "certified_residuals",
    "certify",
    "excess_violation",
    "farkas_residual",
    "is_proven",
    "kkt_residuals",
    "least_violation_residual",
    "misses_a_bound",
    "proof_tolerance",
    "violation",
    "violation_tolerance",
]

_EPS = float(np.finfo(np.float64).eps)
# Lengths of vectors whose squares, and sums of these, neither over- nor underflow: 1e±154 would, for one number.
_SAFE_LENGTH = (1e-140, 1e140)
# Units in which float64 has all its digits: below 1e-292 the last ones of a force are subnormal.
_SAFE_UNIT = (1e-290, 1.7e308)
# Rounding of μ, in the unit of r, from which on r is formed in twice the precision, and its part outside the span of
# the rows allowed nothing: a tenth of the smallest tolerance that anybody asks for. With 1e-12 an error of that
# tolerance is excused; with 1e-14 multipliers of 6 are looked at closely, which takes four times as long.
_DOUBTFUL = 1e-13
# Most that rounding of μ is allowed of r in the span of the rows. With 1e-6 right answers between rows 1e-11 rad from
# opposing are refused, with 1e-4 a wrong one passes whose error is seen in a figure.
_ALLOWED = 1e-5
# What a sum of pairs loses, of each row's and all multipliers' (Σ|μ̂| + |κ̂|): counted as an error, so that no μ̂ is too
# large to be judged. A hundredth of it would be less than is lost; with 2⁻⁹² an error of 1e-9 is seen where μ̂ = 1e19.
_LOST_IN_PAIRS = 2.0**-102


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


def certify(
    problem: DirectionProblem,
    answer: Direction,
    tolerance: float,
    find_contradiction: Callable[[DirectionProblem], object | None] | None = None,
) -> Status:
    """The status that is left of the answer's: OPTIMAL or INFEASIBLE where the problem's data prove it.

    What they do not prove is UNCERTIFIED; any other status claims nothing, and stays. OPTIMAL: every residual is within
    the tolerance, and no constraints contradict each other, which a long gradient may hide. INFEASIBLE: the multipliers
    prove it to √tolerance; the direction violates least to (1 + m) tolerance, in the ball where there is a radius; and
    no direction that meets the constraints is shorter than a hundred times the answer and the gradient, or than the
    radius. find_contradiction: a proof that no direction meets the constraints of a problem with g = 0, None where
    there is none; asked where d misses a bound. It takes a solver, and solvers are built on what stands here.
    """
    is_granted = True
    if answer.status == Status.OPTIMAL:
        is_granted = kkt_residuals(problem, answer).worst <= tolerance
        if is_granted and find_contradiction is not None and misses_a_bound(problem, answer.value):
            alone = (np.zeros(problem.n), problem.jacobian, problem.bound, problem.equality)
            is_granted = find_contradiction(DirectionProblem.trusted(*alone)) is None
    elif answer.status == Status.INFEASIBLE:
        is_granted = (
            farkas_residual(problem, answer.multipliers) <= proof_tolerance(tolerance)
            and excess_violation(problem, answer.value) <= violation_tolerance(tolerance, problem.m)
            and is_out_of_reach(problem, answer.value, answer.multipliers)
        )
    return Status(answer.status) if is_granted else Status.UNCERTIFIED


def kkt_residuals(problem: DirectionProblem, direction: HasValueAndMultipliers) -> KKTResiduals:
    """Residuals of (d, μ) = (direction.value, direction.multipliers) as the module's head defines them.

    Free of the scale of g, of J and of each row. Raises ValueError when value or multipliers have a wrong shape.
    """
    d, mu = real_values("direction.value", direction.value), real_values("direction.multipliers", direction.multipliers)
    require_shape("direction.value", d, (problem.n,))
    require_shape("direction.multipliers", mu, (problem.m,))
    kappa = 1.0 if problem.radius is None else float(getattr(direction, "radius_multiplier", 0.0))
    looks = (_measure(each, seen) for each, seen in _look_closer_and_closer(problem, d, mu, kappa))
    return next((residuals for residuals in looks if residuals is not None), _HOPELESS)


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
    is_off = np.append(False, problem.bound == -np.inf)  # a multiplier there is wrong, whatever the row
    seen = _read(certificate, problem, multipliers, np.where(is_off & (lengths == 0.0), 1.0, lengths))
    return _measure(problem, seen, doubtful=_ALLOWED) or _HOPELESS


def is_proven(problem: DirectionProblem, answer: HasValueAndMultipliers) -> bool:
    """Whether the multipliers prove that nothing meets the constraints, and the value violates them least."""
    return (
        farkas_residual(problem, answer.multipliers) <= FARKAS_TOLERANCE
        and least_violation_residual(problem, answer.value) <= FARKAS_TOLERANCE
    )


@dataclass(frozen=True, eq=False)
class _Seen:
    """What there is to see of an answer where M = I, in the units of the problem.

    mu: μ; kappa: κ, 1 without a radius; rest: ‖r‖, r = κMd − g − Jᵀμ; strength: ‖g‖; length: ‖d‖; rows: Ĵ; bound: b̂;
    slack: Ĵd − b̂; exact: r and d, (n,), where they are known in twice the precision.
    """

    mu: Multipliers
    kappa: float
    rest: float
    strength: float
    length: float
    rows: UnitRows
    bound: Multipliers
    slack: Multipliers
    exact: tuple[Vector, Vector] | None = None


def _look_closer_and_closer(
    problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float
) -> Iterator[tuple[DirectionProblem, _Seen]]:
    """By passes over long vectors, in float64, and as if in twice the precision: until one is enough."""
    metric = problem.metric
    if metric is None and problem.radius is None and problem.is_long:
        yield from _look_in_passes(problem, d, mu)
    if not (np.isfinite(d).all() and np.isfinite(mu).all() and math.isfinite(kappa)):
        return
    if metric is None:
        yield problem, _look(problem, d, mu, kappa)
    units = in_units(problem, d)
    problem, d, mu, kappa = units.problem, *units.inside(d, mu, kappa)
    if metric is not None and metric.ndim == 1:
        yield problem, _look(problem, d, mu, kappa)
    yield problem, _look(problem, d, mu, kappa, closely=True)


def _look_in_passes(problem: DirectionProblem, d: Vector, mu: Multipliers) -> Iterator[tuple[DirectionProblem, _Seen]]:
    """Over the vectors as they are; at nothing where a square leaves float64."""
    lengths, certificate = problem.vectors.lengths(), problem.vectors.certificate(d, mu)
    sizes = [each for i, each in enumerate(lengths.tolist()) if each > 0.0 or not problem.vectors.is_zero(i)]
    sizes += [certificate.length] if certificate.length > 0.0 or d.any() else []
    if _SAFE_LENGTH[0] < min(sizes, default=1.0) and max(sizes, default=1.0) < _SAFE_LENGTH[1]:
        yield problem, _read(certificate, problem, mu, lengths)


def _read(
    certificate: Certificate, problem: DirectionProblem, mu: Multipliers, lengths: Float[np.ndarray, "channels"]
) -> _Seen:
    rows = UnitRows(np.empty((problem.m, 0)), lengths[1:], np.ones(problem.m))
    bound, slack = rows.per_length(problem.bound), rows.per_length(certificate.products - problem.bound)
    return _Seen(mu, 1.0, certificate.rest, float(lengths[0]), certificate.length, rows, bound, slack)


def _look(problem: DirectionProblem, d: Vector, mu: Multipliers, kappa: float, *, closely: bool = False) -> _Seen:
    """In float64; or closely, the problem being in its units, as if in twice the precision, a full metric by itself."""
    g, J, x, L, M = problem.gradient, problem.jacobian, d, problem.whitening, problem.metric
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        if L is not None:
            g, J, x = L.gradient(g), L.rows(J), L.direction(d)
        rows = unit_rows(J)
        bound = rows.per_length(problem.bound)
        strength, length, slack = norm(g), norm(x), rows.jacobian @ x - bound
        if not closely:
            return _Seen(mu, kappa, norm(kappa * x - g - mu @ J), strength, length, rows, bound, slack)
        if L is not None and M is not None and M.ndim == 2:
            rest, length, slack = find_terms(problem, M, d, mu, kappa)
            rest, slack = L.gradient(rest), rows.per_length(slack)
        else:
            rest = find_rest(g, J, Pair(x, np.zeros_like(x)), mu, kappa)
        return _Seen(mu, kappa, norm(rest), strength, length, rows, bound, slack, (rest, x))


def _measure(problem: DirectionProblem, seen: _Seen, *, doubtful: float = _DOUBTFUL) -> KKTResiduals | None:
    """The four residuals; None where a number leaves float64, or rounding of large multipliers hides r."""
    if not seen.rest < math.inf:
        return None
    length, force = _choose_units(problem, seen)
    if problem.radius is None and force == 0.0:  # g = d = 0: nothing to be relative to
        violated = np.where(problem.equality, seen.bound != 0.0, seen.bound > 0.0).any()
        return KKTResiduals(0.0, math.inf if violated else 0.0, 0.0, 0.0)
    pull, room = 0.0, math.inf  # of the ball, as μ̂ and the slack are of a row
    if problem.radius is not None:
        pull, room = seen.kappa / force * length, (problem.radius - seen.length) / length
    with np.errstate(over="ignore", invalid="ignore"):
        mu, slack = seen.rows.times_length(seen.mu, force), seen.slack / length
        stationarity = _forgive_rounding(seen, mu, pull, force, doubtful)
    in_range = _SAFE_UNIT[0] < min(length, force) and max(length, force) < _SAFE_UNIT[1]
    if not (stationarity < math.inf and (in_range or seen.exact)):
        return None
    inequality = ~problem.equality
    return KKTResiduals(
        stationarity=stationarity,
        primal=max(0.0, largest(np.where(inequality, -slack, np.abs(slack))), -room),
        dual=max(0.0, largest(-mu[inequality]), -pull),
        complementarity=max(largest(np.abs(np.minimum(mu, slack))[inequality]), abs(min(pull, room))),
    )


def _forgive_rounding(seen: _Seen, mu: Multipliers, pull: float, force: float, doubtful: float) -> float:
    """‖r‖/γ without what rounding of μ̂ and κ̂ explains, in units of γ; NaN where that is not to be told in float64."""
    total = float(np.abs(mu).sum()) + abs(pull)
    rounding, inside, outside = 8 * _EPS * total, seen.rest / force, 0.0
    if not rounding < doubtful:
        if seen.exact is None or not inside < math.inf:
            return math.nan
        rest, d = seen.exact
        along = d / (norm(d) or 1.0) if pull != 0.0 else np.zeros_like(d)
        inside, outside = split_rest(rest / force, np.vstack([seen.rows.jacobian[mu != 0.0], along]))
        outside += _LOST_IN_PAIRS * (2 + len(mu)) * total
    return math.hypot(outside, max(inside - min(rounding, _ALLOWED), 0.0))


def _choose_units(problem: DirectionProblem, seen: _Seen) -> tuple[float, float]:
    """λ and γ of the module's head."""
    if problem.radius is None:
        sigma = max(seen.strength, seen.length)
        return sigma, sigma
    named = np.abs(seen.bound[(seen.bound != 0.0) & np.isfinite(seen.bound)])
    length = max(seen.length, float(named.min(initial=problem.radius)))
    force = seen.strength or max(largest(np.abs(seen.rows.times_length(seen.mu))), abs(seen.kappa) * length)
    return length, force or 1.0
