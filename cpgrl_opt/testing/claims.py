"""Laws of honest answers: what is claimed is proven, what cannot be done is said, and nothing else is touched."""

import numpy as np

from ..certify import farkas_residual, kkt_residuals, proof_tolerance, violation_tolerance
from ..direction import Status
from ..problem import DirectionProblem
from ..published.euclidean import euclidean
from ..scaling import unit_rows
from ..solvers.facts import tolerance_of
from ..solvers.interface import DirectionSolver
from .law import (
    Answer,
    NothingClaimed,
    Outcome,
    answer_of,
    law,
    length,
    nothing_claimed,
    reference_optimum,
    require,
    require_at_most,
    skip_unless,
    vary,
    whitened,
)
from .sensitivity import distance_bound, hoffman_constant, relative_distance

_ROUNDING = 1e-12  # b̂ − r below this part of the scale is what rounding left of 0


@law
def check_claims_are_certified(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """OPTIMAL implies worst KKT residual ≤ ε, INFEASIBLE a Farkas vector with residual ≤ √ε; for any problem at all.

    With residual ρ the vector proves that no direction shorter than max|b̂|/ρ is feasible; a least-violation residual
    that is good to ε max|b̂| gives ρ ≈ ε (max|b̂|/violation)².
    Source: Nocedal & Wright, Theorem 12.1; Farkas' lemma, Boyd & Vandenberghe, §5.8.
    """
    answer = answer_of(solver, problem)
    if answer.status == Status.OPTIMAL:
        require_at_most(
            kkt_residuals(problem, answer).worst,
            tolerance_of(solver),
            "the worst KKT residual of an OPTIMAL direction",
            "Judge the answer by kkt_residuals before calling it OPTIMAL; else say UNCERTIFIED.",
            problem,
            answer,
        )
    elif answer.status == Status.INFEASIBLE:
        _require_proof(solver, problem, answer)
    else:
        raise NothingClaimed(Outcome.DECLINED)


@law
def check_feasible_is_not_called_infeasible(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """A problem with a feasible direction is not INFEASIBLE. `problem` should be feasible. Source: Farkas' lemma."""
    answer = answer_of(solver, problem)
    message = (
        "the problem has a feasible direction and should not be INFEASIBLE: INFEASIBLE needs a Farkas vector "
        "(y ≥ 0 on I, Jᵀy = 0, bᵀy > 0), and there is none"
    )
    require(answer.status != Status.INFEASIBLE, message, problem, answer)
    if answer.status != Status.OPTIMAL:
        raise nothing_claimed(answer)


@law
def check_infeasible_is_called_infeasible(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """Status INFEASIBLE, with a Farkas vector of residual ≤ √ε as multipliers.

    `problem` should be infeasible by more than √ε max|b̂|. Source: Farkas' lemma; Boyd & Vandenberghe, §5.8.
    """
    _require_proof(solver, problem, _infeasible(solver, problem))


@law
def check_least_violation(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """The direction of an INFEASIBLE answer minimises ‖r‖, r = (b̂ − Ĵd)₊ (signed on E), and is the nearest such to g.

    Least: ‖Ĵᵀr‖ ≤ (1 + m) ε s, the gradient of the convex ½‖r‖², s = max(‖g‖, ‖d‖, b̂₊, |b̂| on E); so r is within
    2H(1 + m)εs of the least one. Nearest: d is within (1 + 2H)(1 + m) · `relative_distance`(ε + its ε) · s of
    `enumeration`'s projection of g onto {Ĵd ≥ b̂ − r}. `problem` should be infeasible; by a zero row: skipped.
    In a ball: ‖Π(d + Ĵᵀr) − d‖ ≤ (2 + m) ε s, Π the projection onto the ball, s = max(radius, b̂₊, |b̂| on E); and of
    several the best climb, gᵀ(d* − d) ≤ ‖g‖ · `distance_bound`((1 + 2H)(1 + m)(ε + its ε)), d* being `enumeration`'s on
    {Ĵd ≥ b̂ − r} in the ball. In a metric all of this is measured where M = I.
    Source: Hoffman's bound and strong convexity in r; Censor & Elfving 1982; Bauschke & Combettes, Proposition 26.2.
    """
    answer = _infeasible(solver, problem)
    rows = unit_rows(euclidean(problem).jacobian)
    bound = rows.per_length(problem.bound)
    skip_unless(bool((bound < np.inf).all() and np.isfinite(bound[problem.equality]).all()))
    value = whitened(problem, answer.value)
    lack = bound - rows.jacobian @ value
    lack = np.where(problem.equality, lack, np.maximum(lack, 0.0))
    required = np.where(problem.equality, np.abs(bound), np.maximum(bound, 0.0))
    pull = rows.jacobian.T @ lack
    if problem.radius is not None:
        unit = max(problem.radius, float(required.max(initial=0.0)))
        _require_least_in_ball(solver, problem, answer, pull, unit)
        _require_best_climb(solver, problem, answer, rows.times_length(lack))
        return
    unit = max(length(euclidean(problem).gradient), length(value), float(required.max(initial=0.0)))
    require_at_most(
        length(pull) / unit,
        violation_tolerance(tolerance_of(solver), problem.m),
        "‖Ĵᵀ(b̂ − Ĵd)₊‖ / s of an INFEASIBLE direction",
        "The direction should violate the constraints least, in the 2-norm on unit rows.",
        problem,
        answer,
    )
    _require_nearest(solver, problem, answer, rows.times_length(lack), unit)


def _require_least_in_ball(
    solver: DirectionSolver, problem: DirectionProblem, answer: Answer, pull: np.ndarray, unit: float
) -> None:
    """The pull Ĵᵀr of what is violated leads out of the ball, or is 0; the ball counts as one constraint more."""
    radius, value = float(problem.radius or 0.0), whitened(problem, answer.value)
    pulled = value + pull
    projected = pulled * min(1.0, radius / (length(pulled) or 1.0))
    require_at_most(
        length(projected - value) / unit,
        violation_tolerance(tolerance_of(solver), problem.m + 1),
        "‖Π(d + Ĵᵀ(b̂ − Ĵd)₊) − d‖ / s of an INFEASIBLE direction, Π the projection onto the ball",
        "The direction should stay in the ball and violate the constraints least there, in the 2-norm on unit rows.",
        problem,
        answer,
    )


def _require_best_climb(solver: DirectionSolver, problem: DirectionProblem, answer: Answer, lack: np.ndarray) -> None:
    """Where the ball holds d back from less violation, d is the only one, and the reference may claim nothing."""
    relaxed = _relaxed(problem, lack, float(problem.radius or 0.0))
    try:
        best, epsilon = _reference(solver, relaxed)
    except NothingClaimed:
        return
    epsilon *= _growth(problem)
    radius, strength = float(problem.radius or 0.0), length(euclidean(problem).gradient)
    kappa, directions = best.radius_multiplier, (answer.value, best.value)
    if kappa > 0.0:
        allowed = distance_bound(relaxed, epsilon, *directions, radius_multiplier=kappa)
    else:
        allowed = relative_distance(relaxed, epsilon) * max(radius, *(length(whitened(problem, d)) for d in directions))
    require_at_most(
        float(problem.gradient @ (best.value - answer.value)) / (strength or 1.0),
        allowed,
        "gᵀ(d* − d) / ‖g‖, d* the best climb of those in the ball that violate least",
        "Of all directions in the ball that violate the constraints least, take the one that climbs most.",
        problem,
        answer,
        best,
    )


def _relaxed(problem: DirectionProblem, lack: np.ndarray, unit: float) -> DirectionProblem:
    """The problem that asks for no more than is there, b − r."""
    bound = problem.bound - lack
    rounding = np.abs(unit_rows(euclidean(problem).jacobian).per_length(bound)) <= _ROUNDING * unit
    # With g = 0 and no other bound, noise would be the whole problem.
    return vary(problem, bound=np.where(rounding, 0.0, bound))


def _require_nearest(
    solver: DirectionSolver, problem: DirectionProblem, answer: Answer, lack: np.ndarray, unit: float
) -> None:
    relaxed = _relaxed(problem, lack, unit)
    nearest, epsilon = _reference(solver, relaxed)
    require_at_most(
        length(whitened(problem, answer.value - nearest.value)) / unit,
        _growth(problem) * relative_distance(relaxed, epsilon),
        "‖d − p(g)‖ / s, p(g) the direction nearest to g of those that violate least",
        "Of all directions that violate the constraints least, take the one nearest to the gradient.",
        problem,
        answer,
        nearest,
    )


def _reference(solver: DirectionSolver, relaxed: DirectionProblem) -> tuple[Answer, float]:
    """The reference's answer, and the residual that the solver's and its own may have together."""
    answer, its_tolerance = reference_optimum(relaxed)
    return answer, tolerance_of(solver) + its_tolerance + _ROUNDING


def _growth(problem: DirectionProblem) -> float:
    """By how much an error of the least violation moves what is asked for: (1 + 2H)(1 + m)."""
    return (1 + 2 * hoffman_constant(problem)) * (1 + problem.m)


def _infeasible(solver: DirectionSolver, problem: DirectionProblem) -> Answer:
    """The answer where it says INFEASIBLE; LawError where it says OPTIMAL."""
    answer = answer_of(solver, problem)
    message = (
        "no direction meets the constraints, so OPTIMAL is wrong: check every constraint of the answer against its "
        "bound, and return INFEASIBLE with a Farkas vector"
    )
    require(answer.status != Status.OPTIMAL, message, problem, answer)
    if answer.status != Status.INFEASIBLE:
        raise nothing_claimed(answer)
    return answer


def _require_proof(solver: DirectionSolver, problem: DirectionProblem, answer: Answer) -> None:
    require_at_most(
        farkas_residual(problem, answer.multipliers),
        proof_tolerance(tolerance_of(solver)),
        "the residual of the Farkas vector y in `multipliers`",
        "INFEASIBLE needs a proof: y ≥ 0 on inequalities with Jᵀy = 0 and bᵀy > 0; (b̂ − Ĵd)₊/‖Jᵢ‖ of the least "
        "violation is one.",
        problem,
        answer,
    )
