"""Laws of invariance: what names, units and coordinates we choose does not move the direction.

Each compares two answers, both within `distance_bound`(ε) of the same optimum, and so allows the sum of the two; where
a ball is slack the optimum need not be unique, and they are skipped.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..problem import DirectionProblem
from ..solvers.facts import tolerance_of
from ..solvers.interface import DirectionSolver
from .law import (
    Answer,
    NothingClaimed,
    Outcome,
    law,
    length,
    optimum_of,
    require_near,
    varied,
)
from .multipliers import require_same_multipliers
from .sensitivity import answers_bound


@law
def check_permutation(solver: DirectionSolver, problem: DirectionProblem, order: ArrayLike) -> None:
    """Rows in another order leave d and reorder μ; the latter where the rows that are on are independent.

    ‖Δd‖ ≤ 2 · `distance_bound`(ε), Δμ as `require_same_multipliers` says. order: (m,), a permutation of 0 … m − 1.
    Source: the problem is a set of constraints.
    """
    index = np.asarray(order, dtype=np.intp)
    other = varied(
        problem, jacobian=problem.jacobian[index], bound=problem.bound[index], equality=problem.equality[index]
    )
    first, second = optimum_of(solver, problem), optimum_of(solver, other)
    allowed = _require_same(
        solver, (problem, other), (first, second), "The order of the rows decides: is a row skipped, or never re-added?"
    )
    in_first_order = replace(second, multipliers=second.multipliers[np.argsort(index)])
    require_same_multipliers(
        solver, problem, (first, in_first_order), allowed, f"after the permutation {index.tolist()}"
    )


@law
def check_row_scaling(solver: DirectionSolver, problem: DirectionProblem, factors: ArrayLike) -> None:
    """(cᵢJᵢ, cᵢbᵢ) with cᵢ > 0 leave d, within 2 · `distance_bound`(ε), and divide μᵢ by cᵢ. factors c: (m,).

    Multipliers are compared where the rows that are on are independent (`require_same_multipliers`).
    Source: {d : cᵢJᵢd ≥ cᵢbᵢ} is the same set.
    """
    c = np.asarray(factors, dtype=np.float64)
    other = varied(problem, jacobian=c[:, None] * problem.jacobian, bound=c * problem.bound)
    first, second = optimum_of(solver, problem), optimum_of(solver, other)
    allowed = _require_same(
        solver,
        (problem, other),
        (first, second),
        "The lengths of the rows decide: normalise them before any rank decision or comparison of multipliers.",
    )
    in_first_unit = replace(second, multipliers=c * second.multipliers)
    require_same_multipliers(
        solver, problem, (first, in_first_unit), allowed, f"after the rows' scaling by {c.tolist()}"
    )


@law
def check_scaling(solver: DirectionSolver, problem: DirectionProblem, factor: float) -> None:
    """(c g, c b) with c > 0 scale d and μ by c: ‖d(cg, cb)/c − d(g, b)‖ ≤ 2 · `distance_bound`(ε).

    Multipliers are compared where the rows that are on are independent (`require_same_multipliers`).

    Source: d ∈ {J d ≥ b} ⇔ c d ∈ {J d ≥ c b}. A problem with a trust region scales its radius too.
    """
    radius = None if problem.radius is None else factor * problem.radius
    other = varied(problem, gradient=factor * problem.gradient, bound=factor * problem.bound, radius=radius)
    first, second = optimum_of(solver, problem), optimum_of(solver, other)
    scaled_back = replace(second, value=second.value / factor, multipliers=second.multipliers / factor)
    allowed = _require_same(
        solver,
        (problem, problem),
        (first, scaled_back),
        "The direction has a length of its own, or an absolute tolerance: divide by σ = max(‖g‖, |b̂|) before solving.",
    )
    require_same_multipliers(solver, problem, (first, scaled_back), allowed, f"after (g, b) times {factor:g}")


@law
def check_duplicate_row(solver: DirectionSolver, problem: DirectionProblem, row: int) -> None:
    """A constraint stated twice leaves d, within the sum of the two `distance_bound`(ε). row: which one is repeated.

    Source: the set is the same; the multipliers are not unique any more.
    """
    twice = np.append(np.arange(problem.m), row)
    other = varied(
        problem, jacobian=problem.jacobian[twice], bound=problem.bound[twice], equality=problem.equality[twice]
    )
    _require_same(
        solver,
        (problem, other),
        (optimum_of(solver, problem), optimum_of(solver, other)),
        "Dependent rows break the factorisation: decide the rank on unit rows, or drop what is implied.",
    )


@law
def check_inactive_row(solver: DirectionSolver, problem: DirectionProblem, row: ArrayLike, margin: float = 1.0) -> None:
    """A strictly inactive row leaves d, within the sum of the two `distance_bound`(ε). row a: (n,).

    Where aᵀd > 0 clearly, aᵀd' ≥ 0 is added, turned round where it is < 0; else skipped. With bounds in the problem
    it is aᵀd' ≥ aᵀd − margin ‖a‖σ. Source: Nocedal & Wright, §12.3: only active constraints shape the optimum.
    """
    first = optimum_of(solver, problem)
    a = np.asarray(row, dtype=np.float64)
    sizes = [length(first.value)] + ([length(problem.gradient)] if problem.radius is None else [])
    along, size = float(a @ first.value), length(a) * max(sizes)
    shifted = bool((problem.bound[~problem.equality] != 0).any())
    if not shifted and not abs(along) > 1e-3 * size:
        raise NothingClaimed(Outcome.SKIPPED)
    new_row, new_bound = (a, along - margin * size) if shifted else (np.copysign(1.0, along) * a, 0.0)
    other = varied(
        problem,
        jacobian=np.vstack([problem.jacobian, new_row]),
        bound=np.append(problem.bound, new_bound),
        equality=np.append(problem.equality, False),
    )
    _require_same(
        solver,
        (problem, other),
        (first, optimum_of(solver, other)),
        "A constraint that is met with room to spare changed the direction: only tight ones may have a multiplier.",
    )


@law
def check_rotation(solver: DirectionSolver, problem: DirectionProblem, rotation: ArrayLike) -> None:
    """Parameters in rotated coordinates: d(Qg, JQᵀ, QMQᵀ) = Q d(g, J, M), within 2 · `distance_bound`(ε); μ stays.

    Multipliers are compared where the rows that are on are independent (`require_same_multipliers`).
    rotation Q: (n, n). Source: the Euclidean projection commutes with isometries.
    """
    Q = np.asarray(rotation, dtype=np.float64)
    M = problem.metric
    if M is not None:
        M = Q @ (np.diag(M) if M.ndim == 1 else M) @ Q.T
        M = 0.5 * (M + M.T)
    other = varied(problem, gradient=Q @ problem.gradient, jacobian=problem.jacobian @ Q.T, metric=M)
    first, second = optimum_of(solver, problem), optimum_of(solver, other)
    turned_back = replace(second, value=Q.T @ second.value)
    allowed = _require_same(
        solver,
        (problem, problem),
        (first, turned_back),
        "The coordinates decide: is the metric not the Euclidean one, or clipping done by component?",
    )
    require_same_multipliers(solver, problem, (first, turned_back), allowed, "after the rotation")


def _require_same(
    solver: DirectionSolver,
    problems: tuple[DirectionProblem, DirectionProblem],
    answers: tuple[Answer, Answer],
    advice: str,
) -> float:
    """LawBroken unless the two directions agree; what was allowed."""
    (first, second), epsilon = answers, tolerance_of(solver)
    allowed = sum(answers_bound(problem, epsilon, first, second) for problem in problems)
    require_near(problems[0], (first, second), allowed, "‖d − d'‖ of two forms of one problem", advice)
    return allowed
