"""Laws of a metric projection p(g), the nearest point of a closed convex set: idempotent and firmly non-expansive.

In a metric M the projection is that of M⁻¹g, directions are measured by ‖d‖_M and gradients by ‖g‖_M⁻¹. A problem with
a radius is no projection, and none of these laws is about it.
"""

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Vector
from ..problem import DirectionProblem
from ..solvers.interface import DirectionSolver, tolerance_of
from .law import Answer, law, length, optimum_of, require_at_most, varied, whitened
from .sensitivity import distance_bound


@law
def check_idempotence(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """p(Mp(g)) = p(g), within 2 · `distance_bound`(ε): d misses the set by at most √m H ε σ.

    Source: Bauschke & Combettes, Convex Analysis and Monotone Operator Theory, §4.1.
    """
    first = optimum_of(solver, problem)
    again = optimum_of(solver, with_gradient(problem, _as_gradient(problem, first.value)))
    require_at_most(
        length(whitened(problem, again.value - first.value)),
        2 * distance_bound(problem, tolerance_of(solver), first.value, again.value),
        "‖p(p(g)) − p(g)‖",
        "Projecting a direction that meets the constraints should leave it: is it rescaled, or a ridge in the way?",
        problem,
        first,
        again,
    )


@law
def check_non_expansiveness(solver: DirectionSolver, problem: DirectionProblem, other: ArrayLike) -> None:
    """‖p(g) − p(h)‖ ≤ ‖g − h‖ + 2δ, δ = `distance_bound`(ε), for another gradient h = `other`, (n,).

    Source: Bauschke & Combettes, Proposition 4.16.
    """
    first, second, delta = _two_projections(solver, problem, other)
    apart = length(_gradient_difference(problem, other))
    require_at_most(
        length(whitened(problem, first.value - second.value)),
        apart * (1 + 1e-14) + 2 * delta,
        f"‖p(g) − p(h)‖ with h = {np.asarray(other).tolist()}",
        "Two directions are farther apart than their gradients: one of them is not the nearest point.",
        problem,
        first,
        second,
    )


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


def with_gradient(problem: DirectionProblem, gradient: ArrayLike) -> DirectionProblem:
    """The same constraints around another gradient."""
    return varied(problem, gradient=gradient)


def _as_gradient(problem: DirectionProblem, direction: Vector) -> Vector:
    """Md, the gradient whose projection without constraints is d."""
    M = problem.metric
    if M is None:
        return direction
    return np.asarray(M * direction if M.ndim == 1 else M @ direction)


def _gradient_difference(problem: DirectionProblem, other: ArrayLike) -> Vector:
    """g − h where M = I."""
    difference = problem.gradient - np.asarray(other, dtype=np.float64)
    return difference if problem.whitening is None else problem.whitening.gradient(difference)


def _two_projections(
    solver: DirectionSolver, problem: DirectionProblem, other: ArrayLike
) -> tuple[Answer, Answer, float]:
    second_problem = with_gradient(problem, other)
    first, second = optimum_of(solver, problem), optimum_of(solver, second_problem)
    epsilon = tolerance_of(solver)
    delta = max(distance_bound(problem, epsilon, first.value), distance_bound(second_problem, epsilon, second.value))
    return first, second, delta
