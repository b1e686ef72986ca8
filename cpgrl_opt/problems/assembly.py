"""Problems put together around a point that meets their constraints, so that nothing is filtered."""

from typing import Any

import numpy as np

from ..arrays import Float, Jacobian, Mask, Vector
from ..problem import DirectionProblem
from .case import Case
from .source import Source


def meet(
    source: Source, jacobian: Jacobian, case: Case, *, bind: int | None = None, equality: Mask | None = None
) -> DirectionProblem:
    """Rows in any order, g, and b = Jd₀ on E, b = Jd₀ − s with s ≥ 0 on I; b = 0 where the case asks for it.

    bind: so many independent rows, or as many as there are, bind at d₀, which is then the optimum: g = d₀ − Jᵀμ with
    μ > 0 on those of I. equality: the rows of E, where they are known.
    Source: Nocedal & Wright, Numerical Optimization, Theorem 12.1 (the optimum of a planted problem).
    """
    m, n = jacobian.shape
    equality = source.equalities(m, case) if equality is None else equality
    point = source.point(n)
    if bind is None:
        bound = jacobian @ point - np.where(equality, 0.0, source.slack(jacobian)) if case.is_shifted else np.zeros(m)
        order = source.order(m)
        return DirectionProblem(source.numbers(n), jacobian[order], bound[order], equality[order])
    order = source.order(m)
    jacobian, equality = jacobian[order], equality[order]
    binding = equality | _independent(jacobian, bind)
    bound = np.zeros(m)
    if case.is_shifted:
        bound = jacobian @ point - np.where(binding, 0.0, source.slack(jacobian))
    else:
        jacobian, point = _turned(jacobian, point, binding)
    weights = np.where(binding, source.integers(1, 9, m), 0)
    weights = weights * np.where(equality, 1.0 - 2.0 * source.integers(0, 1, m), 1.0)
    return DirectionProblem(point - weights @ jacobian, jacobian, bound, equality)


def rescale(problem: DirectionProblem, scale: float, factors: Float[np.ndarray, "m"] | float = 1.0) -> DirectionProblem:
    """(c g, c J, c² b, c radius), row i and bᵢ times factorᵢ: the optimum becomes c d."""
    each = np.broadcast_to(np.asarray(factors, dtype=np.float64), problem.m)
    if scale == 1.0 and (each == 1.0).all():
        return problem
    return DirectionProblem(
        scale * problem.gradient,
        scale * each[:, None] * problem.jacobian,
        scale * (scale * each * problem.bound),
        problem.equality,
        problem.metric,
        None if problem.radius is None else scale * problem.radius,
    )


def vary(problem: DirectionProblem, **changes: Any) -> DirectionProblem:
    """The problem with other arrays for some of its own; metric and radius stay unless they are named."""
    names = ("gradient", "jacobian", "bound", "equality", "metric", "radius")
    return DirectionProblem(**{name: changes.get(name, getattr(problem, name)) for name in names})


def _independent(jacobian: Jacobian, count: int) -> Mask:
    """The first independent rows, at most `count`."""
    taken = np.zeros(len(jacobian), dtype=np.bool_)
    for i in range(len(jacobian)):
        if taken.sum() == count:
            break
        taken[i] = True
        taken[i] = np.linalg.matrix_rank(jacobian[taken]) == taken.sum()
    return taken


def _turned(jacobian: Jacobian, point: Vector, binding: Mask) -> tuple[Jacobian, Vector]:
    """The part d of the point in the null space of the binding rows; the other rows turned so that Jᵢd ≥ 0."""
    rows = jacobian[binding]
    d = point - np.linalg.pinv(rows) @ (rows @ point) if binding.any() else point
    signs = np.where(~binding & (jacobian @ d < 0), -1.0, 1.0)
    return signs[:, None] * jacobian, d
