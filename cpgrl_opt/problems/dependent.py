"""Rows that depend on each other, exactly or nearly: where Gram matrices lose rank and active sets are many."""

import numpy as np

from ..arrays import Jacobian, Multipliers
from ..problem import DirectionProblem
from .assembly import meet
from .case import Case
from .regular import M, N
from .source import Source


def duplicate(source: Source, case: Case, *, opposing: bool = False) -> DirectionProblem:
    """Rows that come twice, in lengths that differ by powers of two, so that they depend exactly.

    opposing: one of them turned round, so that two inequalities make an equality.
    """
    n, m = source.shape(N, 4, least_rows=2)
    J = source.exact((m + 1) // 2, n)[np.arange(m) % ((m + 1) // 2)] * 2.0 ** source.integers(-3, 3, m, 1)
    if opposing:
        J[-1] = -J[-1]
    return meet(source, J, case)


def sum_to_zero(source: Source, case: Case) -> DirectionProblem:
    """Σ Jᵢ = 0 exactly, as Δ² + Δ³ + Δ⁴ = 0 in the paper's three-state MDP."""
    n, m = source.shape(N, M, least_rows=2)
    J = source.exact(m - 1, n)
    return meet(source, np.vstack([J, -J.sum(axis=0)]), case)


def zero_rows(source: Source, case: Case) -> DirectionProblem:
    """A zero row that asks for nothing among others, as of an episode in which nothing happened."""
    n, m = source.shape(N, 4)
    J = source.numbers(m, n)
    J[source.integers(0, m - 1)] = 0.0
    return meet(source, J, case)


def rank_deficient(source: Source, case: Case) -> DirectionProblem:
    """The rank is less than both n and m."""
    n, m = source.shape(N, 4, least_rows=2, least_parameters=2)
    return meet(source, rows_of_rank(source, m, n, source.integers(1, min(n, m) - 1)), case)


def rows_of_rank(source: Source, m: int, n: int, rank: int) -> Jacobian:
    """J of exactly that rank, rows beyond it being sums of the others, in any order."""
    J = source.independent(rank, n)
    sums = source.integers(-1, 1, m - rank, rank) if 0 < rank < m else np.zeros((m - rank, rank))
    rows: Jacobian = np.vstack([J, sums @ J])[source.order(m)]
    return rows


def cone_of_zero(source: Source, case: Case) -> DirectionProblem:  # noqa: ARG001
    """n + 1 rows that span ℝⁿ positively (Σ yᵢJᵢ = 0, y > 0), and one more, n = m − 2: {d : Jd ≥ 0} = {0}.

    Source: Gordan's theorem; Davis 1954, Theory of positive linear dependence.
    """
    _, m = source.shape(4, 6, least_rows=3)
    n = m - 2
    J, _ = positively_dependent(source, source.independent(n, n))
    g = source.numbers(n)
    return DirectionProblem(g, np.vstack([J, source.numbers(n)])[source.order(n + 2)])


def positively_dependent(source: Source, rows: Jacobian) -> tuple[Jacobian, Multipliers]:
    """The rows and one more, and weights y > 0 with Σ yᵢJᵢ = 0 exactly: powers of two, and 1 for the last."""
    y = np.append(2.0 ** source.integers(-1, 1, len(rows)), 1.0)
    return np.vstack([rows, -(y[:-1] @ rows)]), y


def pinched(source: Source, case: Case) -> DirectionProblem:
    """{d : J d ≥ b} is one point, or as flat as its equalities: independent rows Aᵢd = bᵢ, each said in some way.

    As an equality, by two inequalities that oppose each other, or all together by one more row −Σ wᵢAᵢ d ≥ −Σ wᵢbᵢ.
    """
    n, m = source.shape(3, 6, least_rows=2)
    rank = min(n, m - 1)
    n = source.choice((rank, rank, rank, n))
    J, point = source.independent(rank, n), source.point(n)
    equality = source.equalities(rank, case)
    back = -J[~equality]
    if len(back) > 1 and (rank + len(back) > m or source.choice((False, True))):
        back = 2.0 ** source.integers(0, 1, 1, len(back)) @ back
    J, equality = np.vstack([J, back]), np.append(equality, np.zeros(len(back), dtype=np.bool_))
    order = source.order(len(J))
    return DirectionProblem(source.numbers(n), J[order], (J @ point)[order], equality[order])


def nearly_dependent(
    source: Source, case: Case, *, angle: float | tuple[float, float] = (1e-7, 1e-1), opposing: bool = True
) -> DirectionProblem:
    """J₁ and J₂ at `angle` (rad) from opposing, or from parallel, and others: a Gram matrix sees its square only."""
    n, m = source.shape(N, M, least_rows=2, least_parameters=2)
    theta = 10.0 ** source.uniform(*np.log10(angle)) if isinstance(angle, tuple) else angle
    first, second = source.orthonormal(2, n)
    sign = -1.0 if opposing else 1.0
    J = np.vstack([first, sign * np.cos(theta) * first + np.sin(theta) * second, source.numbers(m - 2, n)])
    return meet(source, J * source.uniform(0.5, 2.0, m, 1), case)


def kahan(source: Source, case: Case, *, sine: float = 0.7) -> DirectionProblem:
    """Jᵢ = sⁱ(eᵢ − c Σⱼ eⱼ), j > i, s = sin, c = cos: no pivot warns of it, yet 1/σ_min grows as (1 + c)ᵐ/sᵐ.

    Source: Kahan 1966, Numerical linear algebra; Higham, Accuracy and Stability, §8.3.
    """
    n, m = source.shape(N, 6)
    k = min(n, m)
    J = np.zeros((m, n))
    J[:k, :k] = (sine ** np.arange(k))[:, None] * (np.eye(k) - np.sqrt(1 - sine**2) * np.triu(np.ones((k, k)), 1))
    J[k:] = source.numbers(m - k, n)
    return meet(source, J, case)
