"""The usual way of a long problem, from its Gramian alone, says what the way through coordinates says."""

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.solvers import span
from cpgrl_opt.solvers.gramian_core import solve_by_gramian
from cpgrl_opt.vectors import _numpy as array_vectors

SOLVER = SOLVERS["active-set"]


def usual_answer(problem, tolerance=1e-9):
    return solve_by_gramian(problem, problem.vectors, tolerance)


# Of these every problem is usual; many more families have some.
USUAL = ("well-conditioned", "well-conditioned-bounds", "well-conditioned-equality", "row-scales-1e12", "far-bounds")


@pytest.fixture(autouse=True)
def every_problem_is_long(monkeypatch):
    monkeypatch.setattr(array_vectors, "LEAST_PRODUCTS", 0)


def long_problem(problem):
    """(g g …), (J J …) and r b, r so large that the problem is long."""
    times = max(1, -(-(4 * (1 + problem.m) + 1) // problem.n))
    g, J = np.tile(problem.gradient, times), np.tile(problem.jacobian, (1, times))
    return DirectionProblem(g, J, times * problem.bound, problem.equality)


@pytest.mark.parametrize("name", FAMILIES)
def test_the_usual_way_agrees_with_the_way_through_coordinates(name, monkeypatch):
    for number in range(4):
        problem = long_problem(FAMILIES[name].problem(number, 5))
        is_usual = usual_answer(problem, SOLVER.tolerance) is not None
        assert is_usual or name not in USUAL
        found = SOLVER.solve(problem)
        with monkeypatch.context() as patch:
            patch.setattr(span, "solve_by_gramian", lambda *_: None)
            through = SOLVER.solve(problem)
        assert (found.status, found.rung) == (through.status, through.rung)
        size = max(np.linalg.norm(problem.gradient), np.linalg.norm(through.value))
        assert np.linalg.norm(found.value - through.value) <= 1e-12 * size
        assert found.multipliers == pytest.approx(through.multipliers, rel=1e-9, abs=1e-300)
        if is_usual:
            assert found.residuals is not None
            assert abs(found.residuals.worst - kkt_residuals(problem, found).worst) <= 1e-14


@pytest.mark.parametrize(("bound", "usual"), [(1e3, True), (1e-12, False)])
def test_a_bound_that_is_missed_beside_a_long_gradient_is_not_settled_the_usual_way(bound, usual):
    """Rounding of J d beside ‖g‖ = 1e6 is nothing of σ, and more than a bound of 1e-12 has."""
    rng = np.random.default_rng(3)
    J = rng.standard_normal((2, 40))
    g = 1e6 * (rng.standard_normal(40) - J.sum(axis=0))
    problem = DirectionProblem(g, J, bound)
    assert (usual_answer(problem) is not None) == usual
    assert SOLVER.solve(problem).status == Status.OPTIMAL


@pytest.mark.parametrize(("theta", "usual"), [(0.05, True), (0.005, False)])
def test_rows_that_nearly_oppose_each_other_are_not_usual(theta, usual):
    J = np.zeros((2, 40))
    J[0, 0], J[1, 0], J[1, 1] = 1.0, -np.cos(theta), np.sin(theta)
    assert (usual_answer(DirectionProblem(np.ones(40), J)) is not None) == usual


@pytest.mark.parametrize("spoil", [lambda J: 0.0 * J, lambda J: 1e-150 * J, lambda J: 1e150 * J])
def test_rows_without_a_square_are_not_usual(spoil):
    J = np.eye(2, 40)
    J[0] = spoil(J[0])
    assert usual_answer(DirectionProblem(np.ones(40), J)) is None


def test_arrays_that_change_under_a_problem_are_not_settled_by_what_they_were():
    g, J = np.ones(40), -np.eye(2, 40)
    problem = DirectionProblem(g, J)
    J[0, 0] = 7.0
    assert usual_answer(problem) is None
