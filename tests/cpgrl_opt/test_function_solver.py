"""A plain function as a solver: multipliers that the referee accepts, proofs of infeasibility, and its limits."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings

from cpgrl_opt import SOLVERS, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.published.function_solver import claimed_direction
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


def taking(arguments):
    """A function of these arguments that returns them by name."""
    scope = {}
    exec(f"def f({arguments}):\n    return locals()", scope)
    return scope["f"]


class Bound:
    solve_for = taking("self, g, J, *, bound")
    __call__ = taking("self, g, J, right_hand_side")


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (taking("g, J, b=None"), "b"),
        (taking("g, J, right_hand_side, /, iterations=50"), "right_hand_side"),
        (taking("gradient, jacobian, iterations=50, bounds=None, **options"), "bounds"),
        (taking("g, J, b, *rest"), "b"),
        (Bound(), "right_hand_side"),
        (Bound().solve_for, "bound"),
        (partial(taking("g, J, c, iterations"), iterations=50), "c"),
        (partial(taking("first, g, J, b"), 7), "b"),
    ],
)
def test_the_bound_is_what_has_its_name_or_is_third_without_a_default(function, name):
    g, J, b = np.ones(2), np.eye(2), np.array([5.0, 6.0])
    solver = FunctionSolver(function)
    assert solver.takes_bounds
    given = solver._call(DirectionProblem(g, J, b))
    np.testing.assert_array_equal(given.pop(name), b)
    assert given.get("iterations", 50) == 50


@pytest.mark.parametrize(
    "function",
    [
        taking("g, J, iterations=50, *, verbose=False, **options"),
        taking("g, J=None, iterations=50"),
        partial(taking("g, J, iterations"), iterations=50),
        partial(taking("g, J, b, iterations=50"), b=None),  # whoever sets b means it
    ],
)
def test_what_has_a_default_of_its_own_keeps_it(function):
    """So it did not: b was handed over as the number of iterations."""
    solver = FunctionSolver(function)
    assert not solver.takes_bounds
    assert solver._call(DirectionProblem([1.0, 1.0], np.eye(2)))["iterations"] == 50


@pytest.mark.parametrize(
    "function",
    [
        of_one,
        of_four,
        max,  # compiled, and tells nothing
        partial(taking("g, J, b"), np.ones(2)),
        *map(taking, ("*arguments", "g, J, *rest", "g, J, *, scale", "g, J, radius", "g, J, iterations, b=None")),
        *map(taking, ("g, J, b, bound", "J, g, b", "g, b", "g, J, E")),
    ],
)
def test_a_function_whose_arguments_may_mean_something_else_is_refused_with_what_to_write(function):
    with pytest.raises(ValueError, match=r"function should take \(gradient, jacobian, bound\) .*; found .*Wrap it"):
        FunctionSolver(function)


def test_what_cannot_be_called_is_refused():
    with pytest.raises(ValueError, match="function should be callable; found 3"):
        FunctionSolver(3)


def half_space(g, J, b):
    (a,), (bound,) = J, b
    squares = a @ a
    return g + (max(bound - a @ g, 0.0) / squares if squares else 0.0) * a


def test_a_function_says_in_attributes_what_it_takes_and_promises():
    limited = partial(half_space)
    limited.supports = lambda problem: problem.m == 1
    limited.tolerance, limited.finds_infeasible, limited.dtype = 1e-4, False, "float32"
    for solver in (FunctionSolver(limited), FunctionSolver(partial(limited))):
        assert (solver.tolerance, solver.finds_infeasible, solver.dtype) == (1e-4, False, "float32")
        one, two = DirectionProblem([1.0], [[1.0]]), DirectionProblem([1.0], [[1.0], [2.0]])
        assert solver.supports(one)
        assert not solver.supports(two)
        assert solver.supports(DirectionProblem([1.0], [[1.0], [2.0]], [0.0, -np.inf]))  # one row is handed over
    assert FunctionSolver(limited, tolerance=1e-5).tolerance == 1e-5
    assert (FunctionSolver(half_space).tolerance, FunctionSolver(half_space).finds_infeasible) == (1e-6, True)


def test_a_function_that_fails_is_told_how_to_say_what_it_takes():
    with pytest.raises(ValueError, match="not enough values") as caught:
        FunctionSolver(half_space).solve(DirectionProblem([1.0], np.zeros((0, 1))))
    assert "half_space.supports = lambda problem: …" in caught.value.__notes__[0]
