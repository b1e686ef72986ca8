"""Laws of invariance: what names, units and coordinates we choose does not move the direction.

Each compares two answers, both within `distance_bound`(ε) of the same optimum, and so allows the sum of the two; where
a ball is slack the optimum need not be unique, and they are skipped.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..problem import DirectionProblem
from ..solvers.facts import tolerance_of
from ..solvers.interface import DirectionSolver
from .law import (
    Answer,
    law,
    length,
    optimum_of,
    require_near,
    skip_unless,
    vary,
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
    _require_same(
        solver,
        problem,
        _with_rows(problem, index),
        "The order of the rows decides: is a row skipped, or never re-added?",
        lambda answer: replace(answer, multipliers=answer.multipliers[np.argsort(index)]),
        f"after the permutation {index.tolist()}",
    )


@law
def check_row_scaling(solver: DirectionSolver, problem: DirectionProblem, factors: ArrayLike) -> None:
    """(cᵢJᵢ, cᵢbᵢ) with cᵢ > 0 leave d, within 2 · `distance_bound`(ε), and divide μᵢ by cᵢ. factors c: (m,).

    Multipliers are compared where the rows that are on are independent (`require_same_multipliers`).
    Source: {d : cᵢJᵢd ≥ cᵢbᵢ} is the same set.
    """
    c = np.asarray(factors, dtype=np.float64)
    _require_same(
        solver,
        problem,
        vary(problem, jacobian=c[:, None] * problem.jacobian, bound=c * problem.bound),
        "The lengths of the rows decide: normalise them before any rank decision or comparison of multipliers.",
        lambda answer: replace(answer, multipliers=c * answer.multipliers),
        f"after the rows' scaling by {c.tolist()}",
    )


@law
def check_scaling(solver: DirectionSolver, problem: DirectionProblem, factor: float) -> None:
    """(c g, c b) with c > 0 scale d and μ by c: ‖d(cg, cb)/c − d(g, b)‖ ≤ 2 · `distance_bound`(ε).

    Multipliers are compared where the rows that are on are independent (`require_same_multipliers`).

    Source: d ∈ {J d ≥ b} ⇔ c d ∈ {J d ≥ c b}. A problem with a trust region scales its radius too.
    """
    radius = None if problem.radius is None else factor * problem.radius
    _require_same(
        solver,
        problem,
        vary(problem, gradient=factor * problem.gradient, bound=factor * problem.bound, radius=radius),
        "The direction has a length of its own, or an absolute tolerance: divide by σ = max(‖g‖, |b̂|) before solving.",
        lambda answer: replace(answer, value=answer.value / factor, multipliers=answer.multipliers / factor),
        f"after (g, b) times {factor:g}",
        is_moved=True,
    )


@law
def check_duplicate_row(solver: DirectionSolver, problem: DirectionProblem, row: int) -> None:
    """A constraint stated twice leaves d, within the sum of the two `distance_bound`(ε). row: which one is repeated.

    Source: the set is the same; the multipliers are not unique any more.
    """
    _require_same(
        solver,
        problem,
        _with_rows(problem, np.append(np.arange(problem.m), row)),
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
    skip_unless(shifted or abs(along) > 1e-3 * size)
    new_row, new_bound = (a, along - margin * size) if shifted else (np.copysign(1.0, along) * a, 0.0)
    other = vary(
        problem,
        jacobian=np.vstack([problem.jacobian, new_row]),
        bound=np.append(problem.bound, new_bound),
        equality=np.append(problem.equality, False),
    )
    advice = "A constraint that is met with room to spare changed the direction: only tight ones may have a multiplier."
    _require_same(solver, problem, other, advice, first=first)


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
    _require_same(
        solver,
        problem,
        vary(problem, gradient=Q @ problem.gradient, jacobian=problem.jacobian @ Q.T, metric=M),
        "The coordinates decide: is the metric not the Euclidean one, or clipping done by component?",
        lambda answer: replace(answer, value=Q.T @ answer.value),
        "after the rotation",
        is_moved=True,
    )


def _with_rows(problem: DirectionProblem, index: np.ndarray) -> DirectionProblem:
    """The constraints of these numbers, in this order."""
    jacobian, bound, equality = problem.jacobian[index], problem.bound[index], problem.equality[index]
    return vary(problem, jacobian=jacobian, bound=bound, equality=equality)


def _require_same(
    solver: DirectionSolver, problem: DirectionProblem, other: DirectionProblem, advice: str,
    back: Callable[[Answer], Answer] | None = None, when: str = "", *,
    is_moved: bool = False, first: Answer | None = None,
) -> None:  # fmt: skip
    """LawError unless the problem and another form of it have the same direction, and the same multipliers.

    back: from the answer to the other form to that of the problem; None where the other has more multipliers, which are
    not compared. when: how the message names that form. is_moved: `back` moves d, and both are judged as answers to the
    problem. first: the answer to the problem, where it is known.
    """
    first = first or optimum_of(solver, problem)
    second = optimum_of(solver, other)
    second = second if back is None else back(second)
    forms = (problem, problem if is_moved else other)
    allowed = sum(answers_bound(form, tolerance_of(solver), first, second) for form in forms)
    require_near(problem, (first, second), allowed, "‖d − d'‖ of two forms of one problem", advice)
    if back is not None:
        require_same_multipliers(solver, problem, (first, second), allowed, when)
