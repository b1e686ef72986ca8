"""What an answer to a trust-region problem is worth beside the exact one: verdict, d, κ, and its own certificate."""

import math
from fractions import Fraction
from itertools import combinations

import numpy as np

from cpgrl_opt import Direction, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.exact.rational import dot, fractions_of, solve_all
from cpgrl_opt.exact.trust_region import TrustRegionAnswer

EPS = float(np.finfo(np.float64).eps)
# Rounding errors in the unit of `allowance`. The worst of active-set in 10 800 problems was 0.4 of it, where no ball
# all but touches.
ERRORS = 50.0
# A margin that float64 with a tolerance of 1e-9 need not see: the verdict may be either, or none.
BARELY = 1e-8
# Residual at which a search for κ may end, and how near 1 ‖q‖²/radius² should be for it to show in d.
SEARCHED, NEAR = 1e-12, 1e-6


def allowance(problem: DirectionProblem, exact: TrustRegionAnswer, error: float = ERRORS * EPS) -> float:
    """How far ‖d − d*‖_M/radius may be for a backward error of that size, ε.

    e = ε √cond(M) (1 + |b̂|/radius) / σ, σ the least singular value of the rows that hold d, on each independent subset
    of them: q moves by e, the part of the sphere that it leaves by √(R + e) − √(R − e), and p turns by e/c. R is
    1 − ‖q‖²/radius², or that of the shortest point of all, c = ‖p‖/‖g‖. Where the ball all but touches, e is at least
    1e-12, a residual at which searches end. A point that the ball holds back from less violation moves by e/λ.
    """
    rows, bound = _unit_rows(problem)
    e = error * _conditioning(problem.metric) / _least_singular_value(rows[exact.face])
    demanded = np.where(problem.equality, np.abs(bound), bound).max(initial=0.0) / float(problem.radius or 1.0)
    if not exact.feasible and exact.radius_multiplier:
        return min(2.0, e * (1 + demanded) * (1 + 1 / exact.radius_multiplier))
    R, c = max(0.0, min(exact.room, exact.margin if exact.feasible else 1.0)), exact.climb
    e *= 1 + (demanded if not exact.feasible else 0.0)
    missed = max(e, SEARCHED) if R < NEAR else e
    turn = math.sqrt(R) * min(1.0, e / c) if c else 0.0
    return min(2.0, e + math.sqrt(R + missed) - math.sqrt(max(R - missed, 0.0)) + turn)


def _unit_rows(problem: DirectionProblem) -> tuple[np.ndarray, np.ndarray]:
    """Rows of length 1 in M⁻¹, where M = I, and b̂ on them; rows of length 0 or switched off are zeros."""
    M = np.eye(problem.n) if problem.metric is None else problem.metric
    M = np.diag(M) if M.ndim == 1 else M
    largest = np.abs(problem.jacobian).max(axis=1)
    scale = 2.0 ** -np.floor(np.log2(np.where(largest > 0, largest, 1.0)))
    rows = np.linalg.solve(np.linalg.cholesky(M), (problem.jacobian * scale[:, None]).T).T
    length = np.linalg.norm(rows, axis=1)
    on = (length > 0) & (problem.bound > -np.inf)
    size = np.where(on, length, 1.0)
    return rows * (on / size)[:, None], np.where(on, problem.bound * scale, 0.0) / size


def _conditioning(metric: np.ndarray | None) -> float:
    """√cond(M) with a unit diagonal: units of single parameters lose nothing."""
    if metric is None or metric.ndim == 1:
        return 1.0
    size = np.sqrt(metric.diagonal())
    values = np.linalg.eigvalsh(metric / size / size[:, None])
    return math.sqrt(values[-1] / max(values[0], 1e-17))


def _least_singular_value(rows: np.ndarray) -> float:
    """Of every independent subset; 1 without rows."""
    least = 1.0
    for size in range(1, min(rows.shape) + 1):
        for chosen in combinations(range(len(rows)), size):
            value = float(np.linalg.svd(rows[list(chosen)], compute_uv=False)[-1])
            least = min(least, value) if value > 1e-13 else least
    return least


def distance(problem: DirectionProblem, exact: TrustRegionAnswer, d: np.ndarray) -> float:
    """‖d − d*‖_M/radius, formed in rationals."""
    if not np.isfinite(d).all():
        return math.inf
    apart = [x - y for x, y in zip(fractions_of(d), exact.exact, strict=True)]
    return _size(dot(apart, _times_metric(problem, apart))) / float(problem.radius or 1.0)


def _times_metric(problem: DirectionProblem, vector: list[Fraction]) -> list[Fraction]:
    M = problem.metric
    if M is None:
        return vector
    if M.ndim == 1:
        return [weight * x for weight, x in zip(fractions_of(M), vector, strict=True)]
    return [dot(fractions_of(row), vector) for row in M]


def _size(square: Fraction) -> float:
    """Its root; numbers of 1e±300 do not overflow on the way."""
    shift = (square.numerator.bit_length() - square.denominator.bit_length()) // 2
    return math.ldexp(math.sqrt(square / Fraction(4) ** shift), shift)


def exact_residual(problem: DirectionProblem, answer: Direction) -> float:
    """‖κMd − g − Jᵀμ‖ / max(‖g‖, ‖κMd‖, ‖Jᵢ‖|μᵢ|), in M⁻¹, formed in rationals."""
    d, mu = fractions_of(np.asarray(answer.value)), fractions_of(np.asarray(answer.multipliers))
    kappa, g = Fraction(float(answer.radius_multiplier)), fractions_of(problem.gradient)
    pushes = [[weight * x for x in fractions_of(row)] for weight, row in zip(mu, problem.jacobian, strict=True)]
    force = [kappa * x for x in _times_metric(problem, d)]
    rest = [f - x - sum(push[k] for push in pushes) for k, (f, x) in enumerate(zip(force, g, strict=True))]
    sizes = [_size(dot(each, _by_metric(problem, each))) for each in (rest, g, force, *pushes)]
    return sizes[0] / (max(sizes[1:]) or 1.0)


def _by_metric(problem: DirectionProblem, vector: list[Fraction]) -> list[Fraction]:
    M = problem.metric
    if M is None:
        return vector
    if M.ndim == 1:
        return [x / weight for weight, x in zip(fractions_of(M), vector, strict=True)]
    return (solve_all([fractions_of(row) for row in M], [vector]) or [vector])[0]


def complaint(
    problem: DirectionProblem, exact: TrustRegionAnswer, answer: Direction, tolerance: float, error: float
) -> str:
    """What is wrong with an answer, of whom `tolerance` is promised; empty where nothing is."""
    expected = Status.OPTIMAL if exact.feasible else Status.INFEASIBLE
    if answer.status != expected:
        is_close_call = abs(exact.margin) <= BARELY
        return "" if is_close_call else f"{Status(answer.status).name} for {expected.name}"
    apart, allowed = distance(problem, exact, answer.value), allowance(problem, exact, error)
    if not apart <= allowed:
        return f"‖d − d*‖ = {apart:.2g} radius, for at most {allowed:.2g}"
    if not exact.feasible:
        return "" if _proves(problem, answer.multipliers) else "the multipliers prove nothing"
    reported, residual = kkt_residuals(problem, answer).worst, exact_residual(problem, answer)
    if not max(reported, residual / 2) <= tolerance:
        return f"OPTIMAL with residual {reported:.2g}, and stationarity {residual:.2g} in rationals"
    return _wrong_kappa(problem, exact, answer, allowed)


def _wrong_kappa(problem: DirectionProblem, exact: TrustRegionAnswer, answer: Direction, allowed: float) -> str:
    """κ = ‖p‖/(radius √R), so to allowed/c + allowed/R of itself; not looked at where the ball all but touches."""
    if exact.radius_multiplier is None or min(exact.room, exact.margin) <= allowed:
        return ""
    expected, kappa = exact.radius_multiplier, float(answer.radius_multiplier)
    relative = allowed / exact.climb + allowed / min(exact.room, exact.margin) if expected else 0.0
    strength = _size(dot(fractions_of(problem.gradient), _by_metric(problem, fractions_of(problem.gradient))))
    length = _size(dot(exact.exact, _times_metric(problem, exact.exact)))
    if abs(kappa - expected) * length <= relative * expected * length + max(allowed, SEARCHED) * strength:
        return ""
    return f"κ = {kappa:.17g} for {expected:.17g}"


def _proves(problem: DirectionProblem, y: np.ndarray) -> bool:
    """yᵢ ≥ 0 on I and bᵀy > radius ‖Jᵀy‖_M⁻¹; or ‖Ĵᵀŷ‖ ≤ 1e-6 b̂ᵀŷ/max|b̂|, a proof up to rounding. In rationals."""
    on = problem.bound > -np.inf
    if not np.isfinite(y).all() or (y[~problem.equality] < 0).any() or y[~on].any():
        return False
    weights, bound = fractions_of(y[on]), fractions_of(problem.bound[on])
    rows = [fractions_of(row) for row in problem.jacobian[on]]
    gain = dot(weights, bound)
    pull = [sum((w * row[k] for w, row in zip(weights, rows, strict=True)), Fraction(0)) for k in range(problem.n)]
    force = dot(pull, _by_metric(problem, pull))
    if gain <= 0:
        return False
    sizes = [_size(dot(row, _by_metric(problem, row))) for row in rows]
    nearest = max(
        (abs(float(b)) / size for b, size, w in zip(bound, sizes, weights, strict=True) if w and size), default=0
    )
    reach = max(float(problem.radius or 0.0), nearest)
    return Fraction(float(problem.radius or 0.0)) ** 2 * force < gain**2 or _size(force) * reach <= 1e-6 * float(gain)
