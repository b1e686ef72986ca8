"""A foreign INFEASIBLE is believed where it is proven and its direction violates least, as the kit has it; else not."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from cpgrl_opt import (
    SOLVERS,
    ConstrainedStep,
    Direction,
    DirectionBatch,
    DirectionProblem,
    Linearization,
    Status,
    farkas_residual,
)
from cpgrl_opt.certify import excess_violation
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.comparison.judgement import judge
from cpgrl_opt.solvers import referee
from cpgrl_opt.testing import LawError, check_claims_are_certified, check_least_violation

# Both constraints ask for more of d₂, in opposite directions: no direction serves both.
OPPOSING = Linearization([0.0, -1.0, -1.0], [[1.0, 2.0], [0.0, 1.0], [0.0, -1.0]])
METRIC = np.array([[4.0, 1.0], [1.0, 2.0]])
INFEASIBLE = ("infeasible", "infeasible-four-rows", "infeasible-equality", "weakly-infeasible-1e-4")


@dataclass(frozen=True)
class Foreign:
    """A solver of someone else's: our answer, moved where it is INFEASIBLE.

    shift, (n,), is added to the direction and `impurity` to the first multiplier; in units of the largest.
    """

    shift: tuple[float, ...] = ()
    impurity: float = 0.0
    takes_gradient: bool = False

    takes_geometry: ClassVar[bool] = True

    def solve(self, problem: DirectionProblem) -> Direction:
        answer = SOLVERS["active-set"].solve(problem)
        if answer.status != Status.INFEASIBLE:
            return answer
        value = problem.gradient if self.takes_gradient else answer.value
        multipliers = answer.multipliers.copy()
        multipliers[0] += self.impurity * np.abs(multipliers).max()
        return replace(answer, value=value + np.array(self.shift or np.zeros(problem.n)), multipliers=multipliers)


def step(solver: Foreign, **settings: object) -> ConstrainedStep:
    return ConstrainedStep(solver=solver, formulation="restoring", drop="never", **settings)


@pytest.mark.parametrize("settings", [{}, {"metric": METRIC}])
@pytest.mark.parametrize(
    "solver", [Foreign(takes_gradient=True), Foreign(shift=(1e6, -3e6)), Foreign(shift=(0.0, np.nan))]
)
def test_a_true_proof_with_a_wrong_direction_is_handed_to_the_exact_solver(solver, settings) -> None:
    result = step(solver, **settings)(OPPOSING, [0.0, 0.0])
    exact = step(SOLVERS["active-set"], **settings)(OPPOSING, [0.0, 0.0])
    assert (result.counts["fallback"], result.counts["infeasible"]) == (1, 1)
    np.testing.assert_allclose(result.change, exact.change, atol=1e-14)


@pytest.mark.parametrize("settings", [{}, {"metric": METRIC}])
def test_a_direction_and_a_proof_as_good_as_the_tolerance_are_used(settings) -> None:
    solver = Foreign(shift=(0.0, 1e-7), impurity=1e-5)  # the Farkas residual is 1e-5, and 1e-3 is the worst
    result = step(solver, **settings)(OPPOSING, [0.0, 0.0])
    assert (result.counts["fallback"], result.counts["infeasible"]) == (0, 1)


def test_what_the_kit_accepts_the_step_accepts() -> None:
    rng, outcomes = np.random.default_rng(0), set()
    for name in INFEASIBLE:
        for number in range(2):
            problem = FAMILIES[name].problem(number, 0)
            for size in 10.0 ** np.arange(-9, 1):
                scale = float(np.abs(problem.gradient).max())
                solver = Foreign(tuple(size * scale * rng.standard_normal(problem.n)), impurity=1e3 * size)
                kit = all(_holds(law, solver, problem) for law in (check_claims_are_certified, check_least_violation))
                answer = referee([problem], DirectionBatch.stack([solver.solve(problem)]), 1e-6)
                stands = answer.status[0] == Status.INFEASIBLE
                assert stands or not kit, (name, number, size)
                outcomes.add((kit, stands))
    assert {(True, True), (False, False)} <= outcomes


def _holds(law, solver: Foreign, problem: DirectionProblem) -> bool:
    try:
        law(solver, problem)
    except LawError:
        return False
    return True


def test_violating_least_is_measured_where_the_metric_is_the_identity() -> None:
    rng = np.random.default_rng(1)
    row, metric = rng.standard_normal(3), np.diag([1.0, 100.0, 1e4])
    problem = DirectionProblem(rng.standard_normal(3), np.stack([row, -row]), [1.0, 1.0], metric=metric)
    best = SOLVERS["active-set"].solve(problem)
    assert best.status == Status.INFEASIBLE
    assert farkas_residual(problem, best.multipliers) <= 1e-12
    assert excess_violation(problem, best.value) <= 1e-12
    worse = excess_violation(problem, best.value + 1e-3 * row)
    # r = b̂ ± δ, Ĵᵀr = 2δĴ₁, δ = 1e-3 ‖row‖²/‖row‖_M⁻¹; s = max(‖g‖, ‖d‖) in the metric's lengths
    dual = np.linalg.norm(row / np.sqrt(np.diag(metric)))
    length = np.linalg.norm(np.sqrt(np.diag(metric)) * (best.value + 1e-3 * row))
    unit = max(np.linalg.norm(problem.gradient / np.sqrt(np.diag(metric))), length, 1.0 / dual)
    assert worse == pytest.approx(2e-3 * row @ row / dual / unit, rel=1e-6)


def test_the_comparison_asks_for_the_least_violation_too() -> None:
    problem = FAMILIES["infeasible"].problem(0, 0)
    answer = SOLVERS["active-set"].solve(problem)
    assert judge(problem, answer, feasible=False).outcome == "success"
    elsewhere = replace(answer, value=problem.gradient)
    assert judge(problem, elsewhere, feasible=False).outcome == "inaccurate"
    assert judge(problem, elsewhere, feasible=False, verdict_only=True).outcome == "success"


@pytest.mark.parametrize("metric", [None, METRIC])
def test_in_a_ball_a_direction_is_in_it_and_violates_least_in_it(metric) -> None:
    """Conflicting rows, and rows that the ball misses: d + shift leaves the ball, or violates more in it."""
    missed = Linearization([0.0, -5.0, -3.0], [[1.0, 2.0], [0.0, 1.0], [1.0, 0.5]])
    for linearization in (OPPOSING, missed):
        settings = {"metric": metric, "radius": 0.1, "step_size": 1.0, "restoration_rate": 1.0}
        exact = step(SOLVERS["active-set"], **settings)(linearization, [0.0, 0.0])
        assert exact.counts["infeasible"] == 1
        for shift, falls_back in (((1e6, 1e6), 1), ((-0.02, -0.03), 1), ((0.0, 0.0), 0), ((1e-9, -1e-9), 0)):
            result = step(Foreign(shift=shift), **settings)(linearization, [0.0, 0.0])
            assert (result.counts["fallback"], result.counts["infeasible"]) == (falls_back, 1), (shift, linearization)
            np.testing.assert_allclose(result.change, exact.change, atol=1e-8)


@pytest.mark.parametrize(("angle", "length", "tolerance"), [(1.4e-5, 0.5, 1e-9), (4e-4, 0.5, 1e-6), (4e-4, 0.1, 1e-6)])
@pytest.mark.parametrize("geometry", [{}, {"metric": [4.0, 0.25]}, {"radius": 1e9}])
def test_rows_that_nearly_oppose_are_met_far_away_and_not_infeasible(angle, length, tolerance, geometry) -> None:
    """d = (0, 1/angle) meets both; the claim goes a part of the way, and its y proves no more than that d is long."""
    scale = np.sqrt(np.broadcast_to(geometry.get("metric", 1.0), 2))
    problem = DirectionProblem([0.0, 0.0], np.array([[1.0, angle], [-1.0, angle]]) * scale, 1.0, **geometry)
    claim = Direction(np.array([0.0, length / angle]) / scale, np.ones(2), Status.INFEASIBLE)
    assert referee([problem], DirectionBatch.stack([claim]), tolerance).status[0] == Status.UNCERTIFIED
