"""A plain function as a solver: multipliers that the referee accepts, proofs of infeasibility, and its limits."""

import numpy as np
import pytest
from hypothesis import given, settings

from cpgrl_opt import SOLVERS, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.published.adapter import claimed_direction
from cpgrl_opt.testing import (
    Case,
    FunctionSolver,
    check_direction_solver,
    direction_problems,
    infeasible_problems,
    supported_cases,
)

ORACLE = SOLVERS["enumeration"]


def exact(g, J, b):
    return ORACLE.solve(DirectionProblem(g, J, b)).value


def ascent(g, J):
    return g + 0 * J.sum()


def nothing(g, J, b):
    return None


def too_short(g, J, b):
    return g[:1]


def of_one(g):
    return g


def of_four(g, J, b, equality):
    return g


@settings(max_examples=30)
@given(direction_problems(conflict=(0, 3)))
def test_an_optimal_direction_gets_multipliers_that_the_referee_accepts(problem):
    d = ORACLE.solve(problem).value
    found = claimed_direction(problem, d, 1e-9)
    assert found.status == Status.OPTIMAL
    assert kkt_residuals(problem, found).worst <= 1e-8


@settings(max_examples=30)
@given(infeasible_problems())
def test_a_least_violation_proves_by_itself_that_nothing_is_feasible(problem):
    found = claimed_direction(problem, ORACLE.solve(problem).value, 1e-6)
    assert found.status == Status.INFEASIBLE


@settings(max_examples=30)
@given(direction_problems(conflict=(0, 3)))
def test_a_wrong_direction_of_a_feasible_problem_is_claimed_and_rejected(problem):
    d = ORACLE.solve(problem).value + np.linspace(1.0, 2.0, problem.n)
    found = claimed_direction(problem, d, 1e-6)
    assert found.status == Status.OPTIMAL
    assert kkt_residuals(problem, found).worst > 1e-3


def test_multipliers_worked_out_by_hand():
    """g = (3, −2), J = e₂: d = (3, 0) = g + 2e₂; the slack row e₁ has none, the equality −e₂ would share."""
    problem = DirectionProblem([3.0, -2.0], [[0.0, 2.0], [1.0, 0.0]])
    np.testing.assert_allclose(claimed_direction(problem, [3.0, 0.0], 1e-6).multipliers, [1.0, 0.0], atol=1e-12)
    equality = DirectionProblem([3.0, -2.0], [[0.0, -2.0]], equality=True)
    np.testing.assert_allclose(claimed_direction(equality, [3.0, 0.0], 1e-6).multipliers, [-1.0], atol=1e-12)


def test_an_exact_function_passes_every_law_and_one_that_ignores_the_constraints_does_not():
    laws = ["check_stationarity", "check_primal_feasibility", "check_least_violation", "check_input_is_unchanged"]
    verdict = check_direction_solver(FunctionSolver(exact), max_examples=10, checks=laws)
    verdict.raise_for_failures()
    assert [result.run > 0 for result in verdict.results] == [True] * 4
    assert not check_direction_solver(FunctionSolver(ascent), max_examples=20, checks=laws[1:2]).passed


@pytest.mark.parametrize(
    ("solver", "takes"),
    [
        (FunctionSolver(exact), {Case.CONE, Case.BOUNDS}),
        (FunctionSolver(ascent), {Case.CONE}),
        (FunctionSolver(ascent, as_equalities=True), {Case.TANGENT}),
        (FunctionSolver(exact, as_equalities=True), {Case.TANGENT, Case.AFFINE}),
    ],
)
def test_what_a_function_takes(solver, takes):
    assert set(supported_cases(solver)) == takes
    with_ball = DirectionProblem([1.0, 0.0], [[1.0, 0.0]], equality=solver.as_equalities, radius=1.0)
    assert solver.solve(with_ball).status == Status.UNSUPPORTED


def test_rows_that_are_switched_off_are_not_handed_over_and_copies_are():
    seen = []

    def spoils(g, J, b):
        seen.append((J.shape, b.shape))
        J[:], b[:] = np.nan, np.nan
        return g * 1.0

    problem = DirectionProblem([1.0, 1.0], [[1.0, 0.0], [-1.0, 0.0]], [0.0, -np.inf])
    found = FunctionSolver(spoils).solve(problem)
    assert seen == [((1, 2), (1,))]
    assert found.status == Status.OPTIMAL
    assert kkt_residuals(problem, found).worst == 0.0


def test_none_declines_and_a_wrong_shape_is_refused():
    problem = DirectionProblem([1.0, 1.0], [[1.0, 0.0]])
    assert FunctionSolver(nothing).solve(problem).status == Status.NUMERICAL_ERROR
    with pytest.raises(ValueError, match=r"the direction should have shape \(2,\); found \(1,\)"):
        FunctionSolver(too_short).solve(problem)


@pytest.mark.parametrize("function", [3, of_one, of_four])
def test_what_is_no_function_of_two_or_three_is_refused(function):
    with pytest.raises(ValueError, match="function should"):
        FunctionSolver(function)
