"""Families of trust-region problems in numbers that rational arithmetic takes: integers times powers of two.

    max gᵀd   s.t.   Jd ≥ b, = on E,   dᵀMd ≤ radius²                  n ≤ 9, m ≤ 5

Each family is a function of a generator alone; `trust_regions` puts them to solvers.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np

from cpgrl_opt import DirectionProblem
from cpgrl_opt.exact.trust_region import shortest_length


def integers(rng: np.random.Generator, shape: int | tuple[int, int], largest: int = 3) -> np.ndarray:
    """Whole numbers up to `largest`."""
    return rng.integers(-largest, largest + 1, shape).astype(np.float64)


def sizes(rng: np.random.Generator, least_n: int = 1, least_m: int = 1) -> tuple[int, int]:
    """(n, m)."""
    return int(rng.integers(least_n, 5)), int(rng.integers(least_m, 6))


def rows_of(rng: np.random.Generator, m: int, n: int) -> np.ndarray:
    """Rows of whole numbers, none of them zero."""
    J = integers(rng, (m, n))
    J[~J.any(axis=1), 0] = 1.0
    return J


def some_radius(rng: np.random.Generator) -> float:
    """Between 1/8 and 32."""
    return float(rng.integers(1, 16)) * 2.0 ** float(rng.integers(-3, 2))


def met(rng: np.random.Generator, J: np.ndarray, E: np.ndarray | bool = False) -> np.ndarray:
    """Bounds that a whole point meets."""
    point, slack = integers(rng, J.shape[1], 2), rng.integers(0, 4, len(J)) * 1.0
    return J @ point - np.where(E, 0.0, slack)


def cones(rng: np.random.Generator) -> DirectionProblem:
    """b = 0."""
    n, m = sizes(rng, least_m=0)
    return DirectionProblem(integers(rng, n), rows_of(rng, m, n), radius=some_radius(rng))


def bounds(rng: np.random.Generator) -> DirectionProblem:
    """Any bounds: some balls meet them, some miss, and some are impossible."""
    n, m = sizes(rng)
    return DirectionProblem(integers(rng, n), rows_of(rng, m, n), integers(rng, m), radius=some_radius(rng))


def affine(rng: np.random.Generator) -> DirectionProblem:
    """Equalities that some point meets."""
    n, m = sizes(rng)
    J = rows_of(rng, m, n)
    return DirectionProblem(integers(rng, n), J, met(rng, J, True), True, radius=some_radius(rng))


def mixed(rng: np.random.Generator) -> DirectionProblem:
    """Equalities among inequalities."""
    n, m = sizes(rng, least_m=2)
    J, E = rows_of(rng, m, n), rng.random(m) < 0.4
    return DirectionProblem(integers(rng, n), J, met(rng, J, E), E, radius=some_radius(rng))


def any_constraints(rng: np.random.Generator) -> DirectionProblem:
    """One of the four."""
    draw = (cones, bounds, affine, mixed)[int(rng.integers(4))]
    return draw(rng)


def changed(problem: DirectionProblem, **changes: object) -> DirectionProblem:
    """The problem with other parts."""
    names = ("gradient", "jacobian", "bound", "equality", "metric", "radius")
    return DirectionProblem(**{name: changes.get(name, getattr(problem, name)) for name in names})  # type: ignore[arg-type]


def diagonal_metric(rng: np.random.Generator) -> DirectionProblem:
    """Weights from 2⁻²⁰ to 2²⁰."""
    problem = any_constraints(rng)
    return changed(problem, metric=2.0 ** rng.integers(-20, 21, problem.n))


def full_metric(rng: np.random.Generator) -> DirectionProblem:
    """M = TTᵀ + I."""
    problem = any_constraints(rng)
    T = integers(rng, (problem.n, problem.n))
    return changed(problem, metric=T @ T.T + np.eye(problem.n))


def ill_conditioned_metric(rng: np.random.Generator) -> DirectionProblem:
    """M = TDTᵀ, T unit triangular, D from 1 to 2³³."""
    problem = changed(any_constraints(rng), radius=some_radius(rng) * 2.0 ** float(rng.integers(0, 14)))
    n = problem.n
    T = np.tril(integers(rng, (n, n), 2), -1) + np.eye(n)
    order = rng.permutation(n)
    D = 2.0 ** np.rint(np.linspace(0, 33, n)) if n > 1 else np.ones(1)
    return changed(problem, metric=((T * D[rng.permutation(n)]) @ T.T)[np.ix_(order, order)])


def dependent_rows(rng: np.random.Generator) -> DirectionProblem:
    """Rows twice, opposed, or the sum of two others."""
    n, m = sizes(rng, least_m=2)
    J = rows_of(rng, m, n)
    J[-1] = (J[0], -J[0], J[0] + J[m // 2], -J[:-1].sum(axis=0), 2 * J[0])[int(rng.integers(5))]
    J[~J.any(axis=1), 0] = 1.0
    b = np.zeros(m) if rng.random() < 0.3 else met(rng, J)
    return DirectionProblem(integers(rng, n), J, b, radius=some_radius(rng))


def nearly_opposing_rows(rng: np.random.Generator) -> DirectionProblem:
    """J₂ = −J₁ + a little, 2⁻⁴ … 2⁻²⁴."""
    n, m = sizes(rng, least_n=2, least_m=2)
    J = rows_of(rng, m, n)
    J[1] = -J[0] + integers(rng, n) * 2.0 ** -float(rng.integers(4, 25))
    b = np.zeros(m) if rng.random() < 0.5 else met(rng, J)
    return DirectionProblem(integers(rng, n), J, b, radius=some_radius(rng))


def _at_distance(rng: np.random.Generator, factor: Callable[[], float]) -> DirectionProblem:
    """A ball of `factor` times the length of the shortest direction."""
    problem = any_constraints(rng)
    if rng.random() < 0.4:
        T = integers(rng, (problem.n, problem.n))
        problem = changed(problem, metric=T @ T.T + np.eye(problem.n))
    shortest = shortest_length(problem)
    return changed(problem, radius=shortest * factor()) if shortest else _at_distance(rng, factor)


def touching(rng: np.random.Generator) -> DirectionProblem:
    """The ball reaches the constraints by a part of 0, 2⁻⁴⁰ … 2⁻⁸ of its radius."""
    return _at_distance(rng, lambda: 1.0 + float(rng.integers(0, 5) > 0) * 2.0 ** -float(rng.integers(8, 41)))


def barely_missing(rng: np.random.Generator) -> DirectionProblem:
    """The ball misses the constraints by 2⁻⁴⁰ … 2⁻⁸ of its radius."""
    return _at_distance(rng, lambda: 1.0 - 2.0 ** -float(rng.integers(8, 41)))


def missing(rng: np.random.Generator) -> DirectionProblem:
    """The ball is a half to 2⁻²⁰ of what it should be."""
    return _at_distance(rng, lambda: 2.0 ** -float(rng.choice([1, 2, 5, 20])))


def slack_ball(rng: np.random.Generator) -> DirectionProblem:
    """Rows bound the climb, so that κ = 0 and often many directions climb best."""
    n, m = sizes(rng)
    J = rows_of(rng, m, n)
    weights = rng.integers(0, 3, m) * (rng.random(m) < 0.7)
    b = met(rng, J) if rng.random() < 0.8 else np.zeros(m)
    return DirectionProblem(-(weights @ J), J, b, radius=some_radius(rng) * 8)


def no_gradient(rng: np.random.Generator) -> DirectionProblem:
    """g = 0: the shortest direction, or the least violation."""
    problem = any_constraints(rng)
    return changed(problem, gradient=np.zeros(problem.n))


def huge_ball(rng: np.random.Generator) -> DirectionProblem:
    """A radius of 1e3 … 1e12, as people write "none"."""
    problem = any_constraints(rng)
    if rng.random() < 0.3:
        problem = changed(problem, metric=2.0 ** rng.integers(-3, 4, problem.n))
    return changed(problem, radius=float(10 ** int(rng.integers(3, 13))))


def tiny_ball(rng: np.random.Generator) -> DirectionProblem:
    """A radius of 1e-3 … 1e-12, with bounds of its size, or of size 1."""
    problem, radius = any_constraints(rng), 10.0 ** -float(rng.integers(3, 13))
    small = 2.0 ** round(math.log2(radius))
    return changed(problem, radius=radius, bound=problem.bound * (small if rng.random() < 0.7 else 1.0))


def impossible(rng: np.random.Generator) -> DirectionProblem:
    """Rows with Jᵀy = 0 and bᵀy > 0, in any ball, half of the time in a metric."""
    n, m = sizes(rng, least_m=2)
    J = rows_of(rng, m, n)
    k = int(rng.integers(2, m + 1))
    weights = rng.integers(1, 3, k - 1) * 1.0
    J[k - 1] = -weights @ J[: k - 1]
    E = rng.random(m) < 0.2
    b = met(rng, J, E)
    b[k - 1] = -weights @ b[: k - 1] + float(rng.integers(1, 5))
    order = rng.permutation(m)
    metric = 2.0 ** rng.integers(-6, 7, n) if rng.random() < 0.5 else None
    radius = some_radius(rng) * float(10 ** int(rng.integers(0, 3)))
    return DirectionProblem(integers(rng, n), J[order], b[order], E[order], metric, radius)


def impossible_in_a_huge_ball(rng: np.random.Generator) -> DirectionProblem:
    """Rows of 20 bits that contradict each other, with a radius of 1e9 … 1e12, some people's "none"."""
    n, m = int(rng.integers(3, 10)), int(rng.integers(2, 6))
    J = np.rint(rng.standard_normal((m, n)) * 2**20) / 2**20
    k = int(rng.integers(2, m + 1))
    J[k - 1] = -J[: k - 1].sum(axis=0)
    b = np.rint(J @ rng.standard_normal(n) * 2**20) / 2**20 - rng.integers(0, 3, m)
    b[k - 1] = -b[: k - 1].sum() + 2.0 ** -float(rng.integers(0, 5))
    order = rng.permutation(m)
    g = integers(rng, n) * float(rng.integers(0, 2))
    return DirectionProblem(g, J[order], b[order], radius=float(10 ** int(rng.integers(9, 13))))


def scaled(rng: np.random.Generator) -> DirectionProblem:
    """Gradients, rows and lengths in units of 2⁻⁶⁰ … 2⁶⁰, and rows that ask for nothing."""
    problem = any_constraints(rng)
    g, length = 2.0 ** rng.integers(-60, 61, 2)
    rows = 2.0 ** rng.integers(-60, 61, problem.m)
    J, b = problem.jacobian.copy(), problem.bound.copy()
    if problem.m > 1 and rng.random() < 0.3:
        J[0], b[0] = 0.0, -float(rng.integers(0, 2)) * ~problem.equality[0]
    return changed(
        problem,
        gradient=g * problem.gradient,
        jacobian=rows[:, None] * J,
        bound=rows * length * b,
        radius=(problem.radius or 1.0) * length,
    )


FAMILIES: Mapping[str, Callable[[np.random.Generator], DirectionProblem]] = {
    draw.__name__.replace("_", "-"): draw
    for draw in (
        cones, bounds, affine, mixed, diagonal_metric, full_metric, ill_conditioned_metric, dependent_rows,
        nearly_opposing_rows, touching, barely_missing, missing, slack_ball, no_gradient, huge_ball, tiny_ball,
        impossible, impossible_in_a_huge_ball, scaled,
    )
}  # fmt: skip
