"""Do solvers agree with exact arithmetic on thousands of trust-region problems?

    max gᵀd   s.t.   Jd ≥ b, = on E,   dᵀMd ≤ radius²

The problems are those of the families of `cpgrl_opt.problems`, in five parameters, each in a ball and half of the time
in a metric; and of some families that are about balls. `exact.trust_region` decides each without rounding: the verdict,
d (of several the shortest; where infeasible of least violation, and of those the best climb), κ, and what the answer's
own certificate is worth, the residuals being formed in rationals too.

    python benchmarks/trust_regions.py [--count 100] [--solvers active-set] [--families …] [--seed 0] [--out FOLDER]

A direction agrees where ‖d − d*‖_M ≤ radius · `allowance`, which follows the problem's conditioning; `--count` problems
are drawn of each family. Of those that disagree the smallest stands in the CSV file, as Python. Exit
status 1 if a solver disagreed.
Limitations: n = 5, m ≤ 4.
"""

import math
import sys
import zlib
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import combinations

import numpy as np
from tables import publish, read_arguments, table

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.exact.rational import RationalProblem, dot, fractions_of
from cpgrl_opt.exact.trust_region import TrustRegionAnswer, exact_trust_region
from cpgrl_opt.problems import FAMILIES as KIT
from cpgrl_opt.problems import RandomSource
from cpgrl_opt.solvers import supports

EPS = float(np.finfo(np.float64).eps)
# Rounding errors in the unit of `allowance`. The worst of active-set in 10 800 problems was 0.4 of it, where no ball
# all but touches.
ERRORS = 50.0
# A margin that float64 with a tolerance of 1e-9 need not see: the verdict may be either, or none. In a metric it sees
# √cond(M) less.
BARELY = 1e-8
# Residual at which a search for κ may end, and how near 1 ‖q‖²/radius² should be for it to show in d.
SEARCHED, NEAR = 4e-12, 1e-6


def allowance(problem: DirectionProblem, exact: TrustRegionAnswer, error: float = ERRORS * EPS) -> float:
    """How far ‖d − d*‖_M/radius may be for a backward error of that size, ε.

    e = ε √cond(M) (1 + |b̂|/radius) / σ, σ the least singular value of the rows that hold d, on each independent subset
    of them: q moves by e, the part of the sphere that it leaves by √(R + e) − √(R − e), and p turns by e/c. R is
    1 − ‖q‖²/radius², or that of the shortest point of all, c = ‖p‖/‖g‖. Where the ball all but touches, e is at least
    4e-12, a residual at which searches end. A point that the ball holds back from less violation moves by e/λ.
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
    return root(measure(problem, apart)) / float(problem.radius or 1.0)


def measure(problem: DirectionProblem, vector: list[Fraction]) -> Fraction:
    """vᵀMv."""
    M = problem.metric
    if M is None:
        return dot(vector, vector)
    if M.ndim == 1:
        return dot(vector, [weight * x for weight, x in zip(fractions_of(M), vector, strict=True)])
    return dot(vector, [dot(fractions_of(row), vector) for row in M])


def root(square: Fraction) -> float:
    """Of numbers of 1e±300 too."""
    shift = (square.numerator.bit_length() - square.denominator.bit_length()) // 2
    return math.ldexp(math.sqrt(square / Fraction(4) ** shift), shift)


def exact_residual(problem: DirectionProblem, answer: Direction) -> float:
    """‖κMd − g − Jᵀμ‖ / max(‖g‖, ‖κMd‖, ‖Jᵢ‖|μᵢ|), in M⁻¹, formed in rationals: ‖κMd − Mw‖ is that of κd − w in M."""
    rational, kappa = RationalProblem(problem), Fraction(float(answer.radius_multiplier))
    mu = dict(enumerate(fractions_of(np.asarray(answer.multipliers))))
    weights = {i: mu[i] for i in rational.rows}
    force = [kappa * x for x in fractions_of(np.asarray(answer.value))]
    rest = [f - w for f, w in zip(force, rational.direction(weights, Fraction(1)), strict=True)]
    pushes = (weight**2 * rational.gram[i, i] for i, weight in weights.items())
    largest = max(rational.strength, measure(problem, force), *pushes)
    return root(measure(problem, rest) / (largest or 1))


def complaint(
    problem: DirectionProblem, exact: TrustRegionAnswer, answer: Direction, tolerance: float, error: float
) -> str:
    """What is wrong with an answer, of whom `tolerance` is promised; empty where nothing is."""
    expected = Status.OPTIMAL if exact.feasible else Status.INFEASIBLE
    if answer.status != expected:
        is_close_call = abs(exact.margin) <= BARELY * _conditioning(problem.metric)
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
    strength, length = root(RationalProblem(problem).strength), root(measure(problem, exact.exact))
    if abs(kappa - expected) * length <= relative * expected * length + max(allowed, SEARCHED) * strength:
        return ""
    return f"κ = {kappa:.17g} for {expected:.17g}"


def _proves(problem: DirectionProblem, y: np.ndarray) -> bool:
    """yᵢ ≥ 0 on I and bᵀy > radius ‖Jᵀy‖_M⁻¹; or ‖Ĵᵀŷ‖ ≤ 1e-6 b̂ᵀŷ/max|b̂|, a proof up to rounding. In rationals."""
    rational = RationalProblem(problem)
    if not np.isfinite(y).all() or (y[~problem.equality] < 0).any() or np.delete(y, rational.rows).any():
        return False
    weights = {i: Fraction(float(y[i])) for i in rational.rows}
    gain = sum((weight * rational.b[i] for i, weight in weights.items()), Fraction(0))
    force = sum((weight * rational.along(i, weights) for i, weight in weights.items()), Fraction(0))
    if gain <= 0:
        return False
    asked = (rational.b[i] ** 2 / size for i, w in weights.items() if w and (size := rational.gram[i, i]))
    radius = Fraction(float(problem.radius or 0.0))
    reach = max(float(radius), root(max(asked, default=Fraction(0))))
    return radius**2 * force < gain**2 or root(force) * reach <= 1e-6 * float(gain)


@dataclass(frozen=True)
class Row:
    """One solver on one family, `taken` problems of which it supports; declined: where it claimed nothing.

    worst: ‖d − d*‖ over what is allowed; problem: the smallest that it disagrees on, complaint: what is wrong there.
    """

    solver: str
    family: str
    problems: int
    feasible: int
    taken: int
    agreed: int
    declined: int
    worst: float
    complaint: str
    problem: str


CLAIMS = (Status.OPTIMAL, Status.INFEASIBLE)
# Good to rounding, the others to their tolerance; and these may not decline.
EXACT = ("active-set", "enumeration", "nnls")
# But for those where float64 determines neither verdict nor direction.
FAMILIES = {name: family for name, family in KIT.items() if name not in ("almost opposing", "weakly infeasible")}
# Radii in units of the length of the shortest direction: balls that reach, huge ones ("none"), that touch or nearly so,
# and that miss.
REACHES = (2.0, 1.25, 8.0, 1e3, 1e6, 1e12, 1.0, 1 + 2.0**-20, 1 - 2.0**-20, 1 - 2.0**-8, 0.5, 2.0**-20)
DECADES = (2, 10)  # of a full metric's condition


def problem_of(family: str, number: int, seed: int) -> DirectionProblem:
    """Problem `number` of a family in a ball, the same whatever was drawn before."""
    rng = np.random.default_rng([seed, zlib.crc32(family.encode()), number])
    source = RandomSource(rng, 5, 0 if family == "no constraints" else 4)  # n > m, for g ⟂ J
    drawn = FAMILIES[family].make(source, source.choice(FAMILIES[family].cases))
    if drawn.radius is not None:
        return drawn
    metric = drawn.metric
    if metric is None and source.choice((False, True)):
        metric = source.metric(drawn.n, is_full=source.choice((False, True)), decades=source.choice(DECADES))
    place = partial(DirectionProblem, drawn.gradient, drawn.jacobian, drawn.bound, drawn.equality, metric)
    return place(source.choice(REACHES) * (source.shortest(place()) or source.choice((1.0, 0.25, 5.0))))


def examine(name: str, family: str, count: int, seed: int) -> Row:
    """`count` problems of a family put to a solver."""
    solver, feasible, taken, declined, worst = SOLVERS[name], 0, 0, 0, 0.0
    wrong: list[tuple[DirectionProblem, str]] = []
    error = ERRORS * EPS if name in EXACT else float(solver.tolerance)
    for number in range(count):
        problem = problem_of(family, number, seed)
        exact = exact_trust_region(problem)
        feasible += exact.feasible
        if not supports(solver, problem):
            continue
        taken += 1
        answer = solver.solve(problem)
        told = complaint(problem, exact, answer, solver.tolerance, error)
        if told and answer.status not in CLAIMS and name not in EXACT:
            declined += 1
        elif told:
            wrong.append((problem, told))
        if answer.status == CLAIMS[not exact.feasible]:
            worst = max(worst, distance(problem, exact, answer.value) / allowance(problem, exact, error))
    example, told = min(wrong, key=lambda each: (each[0].jacobian.size, len(state(each[0]))), default=(None, ""))
    shown = "" if example is None else state(example)
    return Row(name, family, count, feasible, taken, taken - len(wrong) - declined, declined, worst, told, shown)


def state(problem: DirectionProblem) -> str:
    """Python that makes it."""
    metric = None if problem.metric is None else problem.metric.tolist()
    parts = (problem.gradient.tolist(), problem.jacobian.tolist(), problem.bound.tolist(), problem.equality.tolist())
    return f"DirectionProblem({', '.join(map(repr, (*parts, metric, problem.radius)))})".replace(
        "-inf", "-float('inf')"
    )


def main() -> None:
    """Examines every solver on every family, and writes the table."""
    arguments = read_arguments(__doc__, count=100, solvers=["active-set"], families=list(FAMILIES), seed=0)
    asked = [(name, family) for name in arguments.solvers for family in arguments.families]
    rows = [examine(*each, arguments.count, arguments.seed) for each in asked]
    heads = "| solver | family | feasible | agree | declined | worst | smallest disagreement |"
    line = (
        "| {0.solver} | {0.family} | {0.feasible:d} | {0.agreed:d} of {0.taken} | {0.declined:d} | {0.worst:.2g} | "
        "{0.complaint} |"
    )
    about = (
        f"{sum(row.taken for row in rows)} problems solved, "
        f"{sum(row.taken - row.agreed - row.declined for row in rows)} disagree. "
        "Worst: ‖d − d*‖ in units of what the problem's conditioning allows."
    )
    publish(arguments, "Trust regions against exact arithmetic", [about, table(heads, line, rows)], rows)
    if any(row.complaint for row in rows):
        sys.exit(1)


if __name__ == "__main__":
    main()
