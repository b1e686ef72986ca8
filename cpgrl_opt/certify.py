"""The referee: optimality residuals from the problem's data, whatever a back end reports.

With unit rows Ĵᵢ = Jᵢ/‖Jᵢ‖, b̂ᵢ = bᵢ/‖Jᵢ‖, μ̂ᵢ = μᵢ‖Jᵢ‖ and σ = max(‖g‖, ‖d‖):

    primal           max (b̂ᵢ − Ĵᵢd)₊ / σ  on I,   max |b̂ᵢ − Ĵᵢd| / σ  on E
    dual             max (−μ̂ᵢ)₊ / σ  on I
    complementarity  max |min(μ̂ᵢ, Ĵᵢd − b̂ᵢ)| / σ  on I
    stationarity     (‖d − g − Jᵀμ‖ − min(8·eps·Σ|μ̂ᵢ|, 1e-5·σ))₊ / σ

The allowance is for what μ itself loses in float64. Where it exceeds 1e-13·σ, the rest is formed in twice the
precision, and only its part in the span of the rows is allowed anything (see `_forgive_rounding`). With g = d = 0
there is no σ: primal is then infinite or 0, and the others are 0.

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
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ._evidence import Evidence, look_in_passes, read_certificate, ways_to_look
from ._violation import (
    FARKAS_TOLERANCE,
    excess_violation,
    farkas_residual,
    is_in_ball,
    is_missed,
    is_out_of_reach,
    largest,
    least_violation_residual,
    misses_a_bound,
    proof_tolerance,
    violation,
    violation_tolerance,
)
from .arrays import Float, Multipliers, Vector
from .direction import Direction, KKTResiduals, Status
from .problem import DirectionProblem, require_problem, without_geometry
from .scaling import norm
from .validation import real_values, require_shape
from .vectors import Certificate

__all__ = [
    "FARKAS_TOLERANCE", "HasValueAndMultipliers", "KKTResiduals", "certified_residuals", "certify", "excess_violation",
    "farkas_residual", "is_proven", "kkt_residuals", "least_violation_residual", "misses_a_bound", "proof_tolerance",
    "violation", "violation_tolerance",
]  # fmt: skip

_EPS = float(np.finfo(np.float64).eps)
# Rounding of μ, in the unit of r, from which on r is formed in twice the precision, and its part outside the span of
# the rows allowed nothing: a tenth of the smallest tolerance that anybody asks for. With 1e-12 an error of that
# tolerance is excused; with 1e-14 multipliers of 6 are looked at closely, which takes four times as long.
_DOUBTFUL = 1e-13
# Most that rounding of μ is allowed of r in the span of the rows. With 1e-6 right answers between rows 1e-11 rad from
# opposing are refused, with 1e-4 a wrong one passes whose error is seen in a figure.
_ALLOWED = 1e-5
# Singular values of unit rows below it are rounding. With 1e-17 rows that depend but for rounding would span a
# direction that they do not. Upwards nothing changed up to 1e-3: what rounding leaves of a right r is along the rows,
# and not along the small difference of two.
_RANK = 1e-13
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
    find_contradiction: Callable[[DirectionProblem], object | None],
) -> Direction:
    """The answer with the status that is left of its own: OPTIMAL or INFEASIBLE where the problem's data prove it.

    What they do not prove is UNCERTIFIED; any other status claims nothing, and stays. OPTIMAL: every residual is within
    the tolerance, and no constraints contradict each other, which a long gradient may hide. INFEASIBLE: the multipliers
    prove it to √tolerance; the direction violates least to (1 + m) tolerance, in the ball where there is a radius; and
    no direction that meets the constraints is shorter than a hundred times the answer and the gradient, or than the
    radius. The residuals are those that OPTIMAL is granted on, else None. find_contradiction: a proof that no direction
    meets the constraints of a problem with g = 0, None where there is none. It is called when d misses a bound, and is
    an argument because solvers import this module.
    """
    is_granted, residuals = True, None
    if answer.status == Status.OPTIMAL:
        residuals, seen = _look_and_measure(problem, answer)
        is_granted = residuals.worst <= tolerance
        if problem.metric is None:
            is_far = seen is not None and is_missed(seen.bound, seen.slack, problem.equality)
        else:  # which may hide it: lengths in M may be 1e7 times the rows' own
            is_far = misses_a_bound(problem, answer.value)
        if is_granted and is_far and problem.is_tree and not problem.vectors.has_rows:
            is_granted = False  # an object of the caller's shows no rows that tell
        elif is_granted and is_far:
            alone = (np.zeros(problem.n), problem.jacobian, problem.bound, problem.equality)
            is_granted = find_contradiction(DirectionProblem.trusted(*alone)) is None
    elif answer.status == Status.INFEASIBLE:
        is_granted = _is_impossible(problem, answer, tolerance)
    if is_granted:
        return replace(answer, status=Status(answer.status), residuals=residuals)
    return replace(answer, status=Status.UNCERTIFIED, residuals=None)


def _is_impossible(problem: DirectionProblem, answer: Direction, tolerance: float) -> bool:
    """As it is, or where metric and ball have no say in it: a contradiction is one of J and b alone."""
    bare = problem if problem.metric is None else without_geometry(problem)
    is_least = excess_violation(problem, answer.value) <= violation_tolerance(tolerance, problem.m)
    if not is_least and bare is not problem and is_in_ball(problem, answer.value):
        is_least = excess_violation(bare, answer.value) <= violation_tolerance(tolerance, problem.m)
    return is_least and any(
        farkas_residual(each, answer.multipliers) <= proof_tolerance(tolerance)
        and is_out_of_reach(each, answer.value, answer.multipliers)
        for each in ((problem,) if bare is problem else (problem, bare))
    )


def kkt_residuals(problem: DirectionProblem, direction: HasValueAndMultipliers) -> KKTResiduals:
    """Residuals of (d, μ) = (direction.value, direction.multipliers) as the module's head defines them.

    Free of the scale of g, of J and of each row. Raises ValueError when value or multipliers have a wrong shape.
    """
    require_problem(problem)
    if problem.is_tree:
        mu, kappa = problem.vectors.agree(_forces_of, problem, direction)
    else:
        mu, kappa = _forces_of(problem, direction)
    d = direction.value if problem.is_tree else problem.row_of(direction.value)
    return _look_and_measure(problem, Direction(d, mu, Status.OPTIMAL, 0, kappa))[0]


def _forces_of(problem: DirectionProblem, direction: HasValueAndMultipliers) -> tuple[Multipliers, float]:
    """(μ, κ)."""
    if not isinstance(direction, HasValueAndMultipliers):
        raise ValueError(f"direction should have value and multipliers; found {direction!r}")
    mu = real_values("direction.multipliers", direction.multipliers)
    require_shape("direction.multipliers", mu, (problem.m,))
    return mu, float(getattr(direction, "radius_multiplier", 0.0))


def certified_residuals(
    certificate: Certificate,
    problem: DirectionProblem,
    multipliers: Multipliers,
    lengths: Float[np.ndarray, "channels"],
    kappa: float = 1.0,
) -> KKTResiduals:
    """The residuals of a certificate; infinite where a number leaves float64, or μ is too large to tell.

    Of a d that was combined of the vectors themselves, or with small multipliers: what rounding of μ is allowed is not
    split into what lies in the span of the rows and what does not. lengths: of g and of each row, 0 for what is 0 or
    off.
    """
    is_off = np.append(False, problem.bound == -np.inf)  # a multiplier there is wrong, whatever the row
    lengths = np.where(is_off & (lengths == 0.0), 1.0, lengths)
    seen = read_certificate(certificate, problem, multipliers, kappa, lengths)
    return _measure(seen, doubtful=_ALLOWED) or _HOPELESS


def is_proven(problem: DirectionProblem, answer: HasValueAndMultipliers) -> bool:
    """Whether the multipliers prove that nothing meets the constraints, and the value violates them least."""
    return (
        farkas_residual(problem, answer.multipliers) <= FARKAS_TOLERANCE
        and least_violation_residual(problem, answer.value) <= FARKAS_TOLERANCE
    )


def _look_and_measure(problem: DirectionProblem, answer: Direction) -> tuple[KKTResiduals, Evidence | None]:
    """The residuals, and what they were measured on; hopeless where nothing tells."""
    kappa = 1.0 if problem.radius is None else answer.radius_multiplier
    has_rows = not problem.is_tree or problem.vectors.has_rows  # else nothing is looked at more closely
    for look in ways_to_look(problem):
        d = problem.row_of(answer.value) if problem.is_tree and look is not look_in_passes else answer.value
        seen = look(problem, d, answer.multipliers, kappa)
        residuals = None if seen is None else _measure(seen, doubtful=_DOUBTFUL if has_rows else _ALLOWED)
        if residuals is not None:
            return residuals, seen
    return _HOPELESS, None


def _measure(seen: Evidence, *, doubtful: float = _DOUBTFUL) -> KKTResiduals | None:
    """The four residuals; None where a number leaves float64, or rounding of large multipliers hides r."""
    if not seen.rest < math.inf:
        return None
    radius, inequality = seen.problem.radius, ~seen.problem.equality
    length, force = _choose_units(seen)
    if force == 0.0:  # g = d = 0, without a radius: nothing to be relative to
        violated = np.where(inequality, seen.bound > 0.0, seen.bound != 0.0).any()
        return KKTResiduals(0.0, math.inf if violated else 0.0, 0.0, 0.0)
    pull, room = 0.0, math.inf  # of the ball, as μ̂ and the slack are of a row
    if radius is not None:
        pull, room = seen.kappa / force * length, (radius - seen.length) / length
    with np.errstate(over="ignore", invalid="ignore"):
        mu, slack = seen.rows.times_length(seen.mu, force), seen.slack / length
        stationarity = _forgive_rounding(seen, mu, pull, force, doubtful)
    if not (stationarity < math.inf and max(length, force) < math.inf):
        return None
    missed = float(np.where(inequality, -slack, np.abs(slack)).max(initial=0.0))
    negative = float(-mu.min(initial=0.0, where=inequality))
    least = float(np.abs(np.minimum(mu, slack)).max(initial=0.0, where=inequality))
    primal, dual = max(0.0, missed, -room), max(0.0, negative, -pull)
    return KKTResiduals(stationarity, primal, dual, max(least, abs(min(pull, room))))


def _forgive_rounding(seen: Evidence, mu: Multipliers, pull: float, force: float, doubtful: float) -> float:
    """‖r‖/γ without what rounding of μ̂ and κ̂, in units of γ, explains; NaN where float64 does not tell.

    r is split, r_in in the span of the rows (and of d, where κ ≠ 0), r_out beside it: to change μ in its last digits
    changes r_in by up to eps Σ|μ̂|, and r_out not at all: that is an error of d, whatever μ.
    """
    total = float(np.abs(mu).sum()) + abs(pull)
    rounding, inside, outside = 8 * _EPS * total, seen.rest / force, 0.0
    if not rounding < doubtful:
        if seen.exact is None or not inside < math.inf:
            return math.nan
        rest, d = seen.exact
        along = d / (norm(d) or 1.0) if pull != 0.0 else np.zeros_like(d)
        inside, outside = _split(rest / force, np.vstack([seen.rows.jacobian[mu != 0.0], along]))
        outside += _LOST_IN_PAIRS * (2 + len(mu)) * total
    return math.hypot(outside, max(inside - min(rounding, _ALLOWED), 0.0))


def _choose_units(seen: Evidence) -> tuple[float, float]:
    """λ and γ of the module's head."""
    if seen.problem.radius is None:
        sigma = max(seen.strength, seen.length)
        return sigma, sigma
    named = np.abs(seen.bound[(seen.bound != 0.0) & np.isfinite(seen.bound)])
    length = max(seen.length, float(named.min(initial=seen.problem.radius)))
    force = seen.strength or max(largest(np.abs(seen.rows.times_length(seen.mu))), abs(seen.kappa) * length)
    return length, force or 1.0


def _split(rest: Vector, directions: Float[np.ndarray, "k n"]) -> tuple[float, float]:
    """(‖r_in‖, ‖r_out‖), the directions being those that r may be changed along, each of length 1 or 0."""
    _, values, basis = np.linalg.svd(directions, full_matrices=False)
    basis = basis[values > _RANK]
    coordinates = basis @ rest
    return norm(coordinates), norm(rest - coordinates @ basis)
