"""Laws of the optimum: d = g + Jᵀμ is the projection of g onto {d : Jᵢd ≥ bᵢ, Jᵢd = bᵢ on E}.

ε is the solver's `tolerance` (1e-6 where it states none); residuals are the referee's (`cpgrl_opt.certify`).
"""

from itertools import combinations
from types import SimpleNamespace

import numpy as np

from ..certify import kkt_residuals
from ..problem import DirectionProblem
from ..projection import RANK_TOLERANCE
from ..published.euclidean import euclidean
from ..scaling import unit_rows
from ..solvers.facts import tolerance_of
from ..solvers.interface import DirectionSolver
from .law import (
    law,
    length,
    optimum_of,
    reference_optimum,
    require_at_most,
    require_near,
    skip_unless,
)
from .multipliers import require_same_multipliers
from .sensitivity import answers_bound, distance_bound, hoffman_constant


@law
def check_stationarity(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """d = g + Jᵀμ: the referee's stationarity ≤ ε.

    Source: Karush, Kuhn, Tucker; Nocedal & Wright, Numerical Optimization, Theorem 12.1.
    """
    advice = "Look at the sign of μ (≥ 0 on inequalities, d = g + Jᵀμ), at a normalised d, and at a ridge in J Jᵀ."
    _require_small(solver, problem, "stationarity", "stationarity ‖d − g − Jᵀμ‖ / σ", advice)


@law
def check_primal_feasibility(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """Jᵢd ≥ bᵢ, Jᵢd = bᵢ on E: the referee's primal ≤ ε. Source: Nocedal & Wright, Theorem 12.1."""
    advice = "A constraint is violated: was it dropped, lost in a rank decision on raw rows, or softened by a ridge?"
    _require_small(solver, problem, "primal", "primal max (b̂ᵢ − Ĵᵢd)₊ / σ", advice)


@law
def check_dual_feasibility(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """μᵢ ≥ 0 on inequalities: the referee's dual ≤ ε. Source: Nocedal & Wright, Theorem 12.1."""
    advice = "An inequality holds g back although g leads away from it: release it. λ of the paper's eq. 7 is −μ."
    _require_small(solver, problem, "dual", "dual max (−μ̂ᵢ)₊ / σ", advice)


@law
def check_complementarity(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """min(μᵢ, Jᵢd − bᵢ) = 0 on I: the referee's complementarity ≤ ε. Source: Nocedal & Wright, Theorem 12.1."""
    advice = "A constraint that is not tight has a multiplier: is the active set that of another problem?"
    _require_small(solver, problem, "complementarity", "complementarity max |min(μ̂ᵢ, Ĵᵢd − b̂ᵢ)| / σ", advice)


@law
def check_gradient_kept_when_feasible(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """J g ≥ b, = b on E, implies d = g, within `distance_bound`(ε). For other problems: skipped.

    Source: a projection fixes the points of its set; Boyd & Vandenberghe, Convex Optimization, §8.1.
    """
    slack = problem.jacobian @ problem.gradient - problem.bound
    skip_unless(bool(np.where(problem.equality, slack == 0, slack >= 0).all()))
    skip_unless(problem.metric is None and problem.radius is None)
    answer = optimum_of(solver, problem)
    require_at_most(
        length(answer.value - problem.gradient),
        distance_bound(problem, tolerance_of(solver), answer.value),
        "‖d − g‖ for a feasible g",
        "The gradient meets every constraint, so it is the answer, unchanged and at its own length.",
        problem,
        answer,
    )


@law
def check_zero_only_when_optimal(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """d = 0 implies −g ∈ {Σ μᵢĴᵢ : b̂ᵢ ≥ −ε‖g‖, μᵢ ≥ 0 on I}, within (1 + m)(ε + 16 m H eps)‖g‖, and b ≤ 0, = 0 on E.

    The nearest such point is found anew, whatever multipliers the solver reports; at most 12 rows.
    Source: Moreau 1962: 0 is the projection of g onto a cone where g is in its polar.
    """
    answer = optimum_of(solver, problem)
    if answer.value.any():
        return
    epsilon = tolerance_of(solver)
    advice = "Zero is an answer only where no feasible direction climbs; failures have a Status of their own."
    with_zeros = SimpleNamespace(value=answer.value, multipliers=np.zeros(problem.m), radius_multiplier=0.0)
    require_at_most(kkt_residuals(problem, with_zeros).primal, epsilon, "primal of d = 0", advice, problem, answer)
    allowed = (1 + problem.m) * (epsilon + 16 * max(problem.m, 1) * hoffman_constant(problem) * 2.0**-52)
    require_at_most(
        _distance_from_polar(problem, epsilon), allowed, "‖g + Jᵀμ‖ / ‖g‖, best μ, at d = 0", advice, problem, answer
    )


@law
def check_agreement_with_enumeration(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """d = the direction of `enumeration`, which tries every active set: within `distance_bound`(ε + its ε).

    So is μ, where the rows that are on are independent (`require_same_multipliers`). The bound grows with
    Hoffman's constant, 1/angle for rows that are nearly dependent: use it for angles > 1e-7.
    Source: the projection onto a closed convex set is unique.
    """
    answer = optimum_of(solver, problem)
    expected, its_tolerance = reference_optimum(problem)
    allowed = answers_bound(problem, tolerance_of(solver) + its_tolerance, answer, expected)
    advice = "Both claim OPTIMAL and the optimum is unique: compare the active sets (μ > 0) of the two answers."
    require_near(problem, (answer, expected), allowed, "‖d − d*‖, d* by enumeration", advice)
    require_same_multipliers(solver, problem, (answer, expected), allowed, "from enumeration")


def _require_small(solver: DirectionSolver, problem: DirectionProblem, part: str, what: str, advice: str) -> None:
    """One of the referee's residuals is within the solver's tolerance."""
    answer = optimum_of(solver, problem)
    residual = getattr(kkt_residuals(problem, answer), part)
    require_at_most(residual, tolerance_of(solver), what, advice, problem, answer)


def _distance_from_polar(problem: DirectionProblem, epsilon: float) -> float:
    """min ‖g + Ĵᵀμ‖ / ‖g‖ over μ ≥ 0 on I, μᵢ = 0 where b̂ᵢ < −ε‖g‖ (−ε·radius in a ball): the best of all sets of rows.

    By enumeration: scipy's nnls reports a residual of 0 for some rows that depend on others (scipy issue 25389).
    """
    gradient, unit = euclidean(problem).gradient, problem.radius
    size = length(gradient)
    if size == 0.0:
        return 0.0
    rows = unit_rows(euclidean(problem).jacobian)
    is_tight = (rows.per_length(problem.bound) >= -epsilon * (unit or size)) & ~problem.equality
    equal = rows.jacobian[problem.equality]
    nearest = np.inf
    for count in range(min(int(is_tight.sum()), problem.n) + 1):
        for chosen in combinations(np.flatnonzero(is_tight), count):
            generators = np.vstack([rows.jacobian[list(chosen)], equal])
            weights = np.linalg.pinv(generators.T, rcond=RANK_TOLERANCE) @ (-gradient / size)
            if (weights[:count] >= 0).all():
                nearest = min(nearest, length(gradient / size + weights @ generators))
    return nearest
