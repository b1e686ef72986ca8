"""Ordinary problems, and those in which some rows, or all, have nothing to say."""

import numpy as np

from ..arrays import Jacobian
from ..problem import DirectionProblem
from .assembly import meet, vary
from .case import Case
from .source import Source

N, M = 9, 3  # the usual small case


def ordinary(source: Source, case: Case, *, n: int = N, m: int = M) -> DirectionProblem:
    """Rows and gradient as they come."""
    n, m = source.shape(n, m)
    return meet(source, source.numbers(m, n), case)


def conditioned(source: Source, case: Case, *, conditioning: float | None = None) -> DirectionProblem:
    """J = U diag(s) Vᵀ, σ₁/σₘ = conditioning, U and V orthonormal."""
    n, m = source.shape(N, M)
    ratio = 10.0 ** source.uniform(0.0, 6.0) if conditioning is None else conditioning
    return meet(source, rows_of_condition(source, m, n, min(m, n), ratio), case)


def rows_of_condition(source: Source, m: int, n: int, rank: int, ratio: float) -> Jacobian:
    """J = U diag(s) Vᵀ of that rank, s from 9 down to 9/ratio in equal steps."""
    U, V = source.orthonormal(m, m)[:, :rank], source.orthonormal(rank, n)
    rows: Jacobian = (U * (9.0 * np.geomspace(1.0, 1.0 / ratio, rank))) @ V
    return rows


def binding(source: Source, case: Case) -> DirectionProblem:
    """Any number of rows up to min(n, m) bind at an optimum that is planted: g = d − Jᵀμ."""
    n, m = source.shape(N, M)
    return meet(source, source.numbers(m, n), case, bind=source.integers(1, min(n, m)))


def no_constraints(source: Source, case: Case) -> DirectionProblem:  # noqa: ARG001
    """m = 0: d = g."""
    n, _ = source.shape(M, 0, least_rows=0)
    return DirectionProblem(source.numbers(n), np.zeros((0, n)))


def feasible_gradient(source: Source, case: Case) -> DirectionProblem:
    """J g ≥ b, = b on E: nothing is to be done, d = g. Exactly so of integers."""
    n, m = source.shape(N, M)
    g, J = source.numbers(n), source.numbers(m, n)
    if case == Case.CONE:
        return DirectionProblem(g, np.where(J @ g < 0, -1.0, 1.0)[:, None] * J)
    if case == Case.TANGENT:  # (gᵀg) Jᵢ − (Jᵢg) gᵀ is orthogonal to g, in integers
        return DirectionProblem(g, (g @ g) * J - np.outer(J @ g, g), 0.0, True)
    equality = source.equalities(m, case)
    return DirectionProblem(g, J, J @ g - np.where(equality, 0.0, source.slack(J)), equality)


def degenerate_vertex(source: Source, case: Case) -> DirectionProblem:
    """Small-integer rows through one integer point: every active set but few is degenerate."""
    n, m = source.shape(3, 8)
    J = source.integers(-2, 2, m, n).astype(np.float64)
    J[(J == 0).all(axis=1), 0] = 1.0
    vertex = source.integers(-3, 3, n).astype(np.float64)
    return DirectionProblem(vertex - J.T @ source.integers(0, 2, m), J, J @ vertex, source.equalities(m, case))


def switched_off(source: Source, case: Case) -> DirectionProblem:
    """Half of the rows, if they are inequalities, have b = −∞, as in a batch of active sets."""
    base = ordinary(source, case, m=6)
    off = source.order(base.m) < base.m // 2
    return vary(base, bound=np.where(off & ~base.equality, -np.inf, base.bound))


def far_bounds(source: Source, case: Case, *, decades: tuple[float, float] = (3.0, 12.0)) -> DirectionProblem:
    """Half of the inequalities have b between −10³ and −10¹²: they never bind, but they spoil an absolute scale."""
    base = ordinary(source, case, m=6)
    is_far = (source.order(base.m) < max(base.m // 2, 1)) & ~base.equality
    return vary(base, bound=np.where(is_far, -(10.0 ** source.uniform(*decades, base.m)), base.bound))
