"""Laws of a metric projection p(g), the nearest point of a closed convex set: idempotent and firmly non-expansive.

In a metric M the projection is that of M⁻¹g, directions are measured by ‖d‖_M and gradients by ‖g‖_M⁻¹. A problem with
a radius is no projection, and none of these laws is about it. Onto {d : J d = 0} p is linear, the paper's P.
"""

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Vector
from ..problem import DirectionProblem
from ..solvers.facts import tolerance_of
from ..solvers.interface import DirectionSolver
from .law import (
    Answer,
    law,
    length,
    optimum_of,
    require_at_most,
    require_near,
    skip_unless,
    vary,
    whitened,
)
from .sensitivity import distance_bound


@law
def check_idempotence(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """p(Mp(g)) = p(g), within 2 · `distance_bound`(ε): d misses the set by at most √m H ε σ.

    Source: Bauschke & Combettes, Convex Analysis and Monotone Operator Theory, §4.1.
    """
    first = optimum_of(solver, problem)
    again = optimum_of(solver, with_gradient(problem, _as_gradient(problem, first.value)))
    allowed = 2 * distance_bound(problem, tolerance_of(solver), first.value, again.value)
    advice = "Projecting a direction that meets the constraints should leave it: is it rescaled, or a ridge in the way?"
    require_near(problem, (first, again), allowed, "‖p(p(g)) − p(g)‖", advice)


@law
def check_non_expansiveness(solver: DirectionSolver, problem: DirectionProblem, other: ArrayLike) -> None:
    """‖p(g) − p(h)‖ ≤ ‖g − h‖ + 2δ, δ = `distance_bound`(ε), for another gradient h = `other`, (n,).

    Source: Bauschke & Combettes, Proposition 4.16.
    """
    first, second, delta = _two_projections(solver, problem, other)
    apart = length(_gradient_difference(problem, other))
    allowed = apart * (1 + 1e-14) + 2 * delta
    advice = "Two directions are farther apart than their gradients: one of them is not the nearest point."
    require_near(problem, (first, second), allowed, f"‖p(g) − p(h)‖ with h = {np.asarray(other).tolist()}", advice)


@law
def check_firm_non_expansiveness(solver: DirectionSolver, problem: DirectionProblem, other: ArrayLike) -> None:
    """‖p(g) − p(h)‖² ≤ ⟨p(g) − p(h), g − h⟩ + 6δ‖g − h‖ + 4δ², δ = `distance_bound`(ε), h = `other`, (n,).

    With D the computed difference and D* the true one, ‖D − D*‖ ≤ 2δ and ‖D*‖ ≤ ‖g − h‖ give the allowance.
    Source: Zarantonello 1971; Bauschke & Combettes, Proposition 4.16.
    """
    first, second, delta = _two_projections(solver, problem, other)
    D, G = whitened(problem, first.value - second.value), _gradient_difference(problem, other)
    unit = max(length(D), length(G))
    if unit == 0.0:
        return
    D, G, delta = D / unit, G / unit, delta / unit
    require_at_most(
        float(D @ D - D @ G),
        1e-14 + 6 * delta * length(G) + 4 * delta**2,
        f"‖D‖² − ⟨D, g − h⟩ over the square of the larger, D = p(g) − p(h), h = {np.asarray(other).tolist()}",
        "One of the two directions is not the nearest point of the set to its gradient.",
        problem,
        first,
        second,
    )


@law
def check_restoration_is_normal(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """P v = 0 for v = p(0) on {v : J v = b}, the restoration: ‖P v‖ ≤ δ + δ′, P v being p(v) on {s : J s = 0}.

    v is within δ = `distance_bound`(ε) of J⁺b, which P takes to 0, and P v is found within δ′ = that of the second
    problem. With b = −slack v is −d of eq. 10, so P d = 0. In a metric, with a radius or an inequality: skipped.
    Source: eq. 9–10 of the paper; Ben-Israel & Greville, Generalized Inverses, §3.2.
    """
    skip_unless(_is_tangent_face(problem))
    restoring = with_gradient(problem, np.zeros(problem.n))
    v = optimum_of(solver, restoring)
    tangent = vary(restoring, gradient=v.value, bound=np.zeros(problem.m))
    s = optimum_of(solver, tangent)
    epsilon = tolerance_of(solver)
    require_at_most(
        length(s.value),
        distance_bound(restoring, epsilon, v.value) + distance_bound(tangent, epsilon, s.value),
        f"‖P v‖, v = {v.value.tolist()} the restoration",
        "The restoration has a tangent part, so it is not the shortest: J⁺b = Jᵀ(J Jᵀ)⁺b has none.",
        restoring,
        v,
        s,
    )


@law
def check_symmetry(solver: DirectionSolver, problem: DirectionProblem, other: ArrayLike) -> None:
    """⟨P a, b⟩ = ⟨a, P b⟩ within δ‖b‖ + δ′‖a‖, P a = p(a) on {s : J s = 0}, a = g and b = `other`, (n,): P = Pᵀ.

    δ and δ′ are the `distance_bound`(ε) of the two answers. Of all projections onto the tangent space only the
    orthogonal one is symmetric. In a metric, with a radius, an inequality or b ≠ 0: skipped.
    Source: eq. 9 of the paper; Halmos, Finite-Dimensional Vector Spaces, §75.
    """
    skip_unless(_is_tangent_face(problem) and not problem.bound.any())
    second_problem = with_gradient(problem, other)
    first, second = optimum_of(solver, problem), optimum_of(solver, second_problem)
    sizes = [length(problem.gradient), length(second_problem.gradient)]
    if not all(sizes):
        return
    a, b = problem.gradient / sizes[0], second_problem.gradient / sizes[1]
    epsilon = tolerance_of(solver)
    bounds = [distance_bound(problem, epsilon, first.value), distance_bound(second_problem, epsilon, second.value)]
    require_at_most(
        abs(float(first.value / sizes[0] @ b - a @ (second.value / sizes[1]))),
        sum(bound / size for bound, size in zip(bounds, sizes, strict=True)),
        f"|⟨P a, b⟩ − ⟨a, P b⟩| / (‖a‖ ‖b‖) with b = {np.asarray(other).tolist()}",
        "P projects along another direction than the rows of J: a metric, unequal steps, or weights in the way?",
        problem,
        first,
        second,
    )


def _is_tangent_face(problem: DirectionProblem) -> bool:
    return problem.metric is None and problem.radius is None and bool(problem.equality.all())


def with_gradient(problem: DirectionProblem, gradient: ArrayLike) -> DirectionProblem:
    """The same constraints around another gradient."""
    return vary(problem, gradient=gradient)


def _as_gradient(problem: DirectionProblem, direction: Vector) -> Vector:
    """Md, the gradient whose projection without constraints is d."""
    M = problem.metric
    if M is None:
        return direction
    return np.asarray(M * direction if M.ndim == 1 else M @ direction)


def _gradient_difference(problem: DirectionProblem, other: ArrayLike) -> Vector:
    """g − h where M = I."""
    difference = problem.gradient - np.asarray(other, dtype=np.float64)
    return difference if problem.whitening is None else problem.whitening.rows(difference)


def _two_projections(
    solver: DirectionSolver, problem: DirectionProblem, other: ArrayLike
) -> tuple[Answer, Answer, float]:
    second_problem = with_gradient(problem, other)
    first, second = optimum_of(solver, problem), optimum_of(solver, second_problem)
    epsilon = tolerance_of(solver)
    delta = max(distance_bound(problem, epsilon, first.value), distance_bound(second_problem, epsilon, second.value))
    return first, second, delta
