"""How far two answers to one problem may be apart when both have small residuals: Hoffman's constant.

    H = max { 1/σ_min(Ĵ_S) : S ⊆ {1 … m}, rows Ĵ_S independent }

Let (d, μ) have residuals ≤ ε (relative to σ = max(‖g‖, ‖d‖), as the referee has them). Then it solves exactly a
problem with g moved by at most (1 + 2m) εσ and b̂ by at most εσ in each row: leave out the multipliers that are
negative or stand at rows that are not tight, each at most εσ. The projection is non-expansive in g and, piecewise
d = g + Ĵ_S⁺(b̂_S − Ĵ_S g), Lipschitz in b̂ with the constant H, so

    ‖d − d*‖ ≤ (1 + 2m + √m H) ε′ σ,      ε′ = ε + 16 m H eps

with the referee's allowance for large multipliers, and the rounding of the data, in ε′. In a metric all of this is so
where M = I.

In a ball d solves that problem for the gradient g/κ, so with σ = max(‖g‖/κ, ‖d‖) it is within δ of P_C(g/κ), the point
of the path t ↦ P_C(tg) at t = 1/κ, whose length differs from the radius by δ + ε·radius =: η. Of two points of the path
‖x(t₂) − x(t₁)‖² ≤ ‖x(t₂)‖² − ‖x(t₁)‖², t₁ ≤ t₂, so ‖d − d*‖ ≤ δ + √((2·radius + η)η): a coarse bound, but one that
holds however nearly the ball misses the constraints. For κ = 0 there is none, for the optimum need not be unique.
Source: Hoffman 1952, On approximate solutions of systems of linear inequalities; Mangasarian & Shiau 1987.
"""

from functools import lru_cache
from itertools import combinations
from math import comb

import numpy as np

from ..direction import Status
from ..problem import DirectionProblem
from ..projection import RANK_TOLERANCE
from ..published.euclidean import euclidean
from ..scaling import unit_rows
from ..solvers import SOLVERS
from ..solvers.facts import tolerance_of
from ..solvers.interface import DirectionSolver
from .law import Answer, length, require_near, same_bits, skip_unless, whitened

_EPS = float(np.finfo(np.float64).eps)
MOST_SETS = 10_000  # of rows, whose singular values are looked at


def hoffman_constant(problem: DirectionProblem) -> float:
    """H of the rows that are switched on; 1 where there are none.

    Sets of rank(Ĵ) rows are enough: each independent set is part of one, whose σ_min is no larger.

    Parameters
    ----------
    problem
        Its metric counts: Ĵ are unit rows where M = I.

    Returns
    -------
    float
        H ≥ 1, without a unit.

    Raises
    ------
    ValueError
        Beyond 10 000 sets of rank(Ĵ) rows.

    Notes
    -----
    Source: Cauchy's interlacing theorem; Horn & Johnson, Matrix Analysis, Theorem 7.3.9.
    """
    rows = unit_rows(euclidean(problem).jacobian).jacobian[(problem.bound > -np.inf) & problem.jacobian.any(axis=1)]
    return 1.0 if len(rows) < 2 else _constant_of(rows.tobytes(), *rows.shape)


@lru_cache(maxsize=8)  # by the rows: a law asks about one set of them, in several problems, several times
def _constant_of(numbers: bytes, m: int, n: int) -> float:
    rows = np.linalg.qr(np.frombuffer(numbers).reshape(m, n).T)[1].T  # the same angles in at most m coordinates
    values = np.linalg.svd(rows, compute_uv=False)
    rank = int((values > RANK_TOLERANCE).sum())
    if rank == len(rows):
        return max(1.0, 1.0 / float(values[-1]))
    if comb(len(rows), rank) > MOST_SETS:
        raise ValueError(f"problem should have at most {MOST_SETS} sets of {rank} constraints; found {len(rows)} rows")
    smallest = np.linalg.svd(rows[np.array(list(combinations(range(len(rows)), rank)))], compute_uv=False)[:, -1]
    return float((1.0 / smallest[smallest > RANK_TOLERANCE]).max(initial=1.0))


def relative_distance(problem: DirectionProblem, residual: float) -> float:
    """(1 + 2m + √m H) ε′ of the module's head: ‖d − d*‖/σ for any d with KKT residuals ≤ residual."""
    H, m = hoffman_constant(problem), problem.m
    return float((1 + 2 * m + np.sqrt(m) * H) * (residual + 16 * max(m, 1) * H * _EPS))


def distance_bound(
    problem: DirectionProblem, residual: float, *directions: np.ndarray, radius_multiplier: float = 0.0
) -> float:
    """‖d − d*‖ for any d with KKT residuals ≤ residual, as the module's head derives it.

    Parameters
    ----------
    problem
        What d answers.
    residual
        The referee's worst, relative.
    directions
        d, (n,), and others: σ = max(‖g‖, ‖d‖) over all of them.
    radius_multiplier
        κ in a ball, the least of all answers'.

    Returns
    -------
    float
        In the unit and the metric of d; inf in a ball with κ = 0.
    """
    g, lengths = euclidean(problem).gradient, [length(whitened(problem, d)) for d in directions]
    if problem.radius is None:
        return relative_distance(problem, residual) * max(length(g), *lengths)
    if not radius_multiplier > 0.0:
        return float("inf")
    delta = relative_distance(problem, residual) * max(length(g) / radius_multiplier, *lengths)
    excess = delta + residual * problem.radius
    return float(delta + np.sqrt(2 * problem.radius + excess) * np.sqrt(excess))


def answers_bound(problem: DirectionProblem, residual: float, *answers: Answer) -> float:
    """`distance_bound` of answers to one problem; where the ball is slack nothing can be said of them: skipped.

    Whether it is slack is for a certified κ* to say, not for the answers. Theirs enter between κ*/4 and κ* only: where
    an answer with small residuals has a smaller κ, the ball holds it so weakly that the bound at κ*/4 exceeds the
    ball's diameter.
    """
    kappa = 1.0
    if problem.radius is not None:
        certified = _certified_radius_multiplier(problem)
        told = min(answer.radius_multiplier for answer in answers)
        kappa = min(max(told, certified / 4), certified) if told > 0 else certified / 4  # told may be NaN
    bound = distance_bound(problem, residual, *(answer.value for answer in answers), radius_multiplier=kappa)
    skip_unless(bound < np.inf)
    return bound


def require_same_optimum(
    solver: DirectionSolver, problem: DirectionProblem, answers: tuple[Answer, Answer], what: str, advice: str
) -> None:
    """LawError unless two OPTIMAL answers of a solver to one problem are within 2 · `answers_bound`(ε)."""
    first, second = answers
    if first.status == second.status == Status.OPTIMAL and not same_bits(first, second):
        allowed = 2 * answers_bound(problem, tolerance_of(solver), first, second)
        require_near(problem, answers, allowed, what, advice)


@lru_cache(maxsize=8)  # by identity: a law asks for each form of a problem once or twice
def _certified_radius_multiplier(problem: DirectionProblem) -> float:
    """κ* of a direction that the referee certifies; 0 where there is none."""
    answer = SOLVERS["active-set"].solve(problem)
    return answer.radius_multiplier if answer.status == Status.OPTIMAL else 0.0
