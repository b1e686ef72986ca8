"""Every solver on problems that a reader solves with a pencil, and every status reached."""

import dataclasses

import numpy as np
import pytest

from cpgrl_opt.certify import farkas_residual, kkt_residuals
from cpgrl_opt.direction import DirectionError, Status
from cpgrl_opt.problem import DirectionProblem
from cpgrl_opt.solvers import (
    SOLVERS,
    DirectionSolver,
    Enumeration,
    QPSolversBackend,
    RosenDrop,
    is_installed,
    supports,
    tolerance_of,
)
from cpgrl_opt.solvers.through_qpsolvers import BACK_ENDS

SOLVER = [pytest.param(solver, id=name) for name, solver in SOLVERS.items() if is_installed(solver)]

# problem → the direction, and the multipliers where they are unique
BY_HAND = {
    "one wall turns the gradient": (DirectionProblem([1, 1], [[-1, 0]]), [0, 1], [1]),
    "a long row is the same wall": (DirectionProblem([1, 1], [[-1e9, 0]]), [0, 1], [1e-9]),
    "a corner stops it": (DirectionProblem([-1, -2], np.eye(2)), [0, 0], [1, 2]),
    "a bound pushes": (DirectionProblem([0, 0], [[1, 1]], 2), [1, 1], [1]),
    "a bound allows a step back": (DirectionProblem([-3, 5], [[1, 0]], -1), [-1, 5], [2]),
    "an equality holds both ways": (DirectionProblem([1, 2], [[0, 1]], 0, True), [1, 0], [-2]),
    "an equality beside a wall": (
        DirectionProblem([1, 1, 1], [[0, 0, 1], [-1, 0, 0]], [2, 0], [True, False]),
        [0, 1, 2],
        [1, 1],
    ),
    "the same wall twice": (DirectionProblem([1, 1], [[-1, 0], [-2, 0]]), [0, 1], None),
    "opposing walls make an equality": (DirectionProblem([1, 1], [[1, 0], [-3, 0]]), [0, 1], None),
    "three walls that sum to zero": (DirectionProblem([1, 2], [[1, 0], [-1, 1], [0, -1]]), [0, 0], None),
    "a zero row is met": (DirectionProblem([1, 1], [[0, 0], [-1, 0]], [-1, 0]), [0, 1], [0, 1]),
    "a constraint is switched off": (DirectionProblem([1, 1], [[-1, 0], [0, -1]], [0, -np.inf]), [0, 1], [1, 0]),
    "a bound too low to matter": (DirectionProblem([1, 1], [[-1, 0], [0, -1]], [0, -1e12]), [0, 1], [1, 0]),
    "no constraints": (DirectionProblem([1, 2], np.zeros((0, 2))), [1, 2], []),
    "no gradient": (DirectionProblem([0, 0], np.eye(2), [-1, 0]), [0, 0], [0, 0]),
    "one parameter": (DirectionProblem([-3], [[2], [-1]], [1, -4]), [0.5], [1.75, 0]),
}

IMPOSSIBLE = {
    "opposing walls apart": (DirectionProblem([0.3, 0.7], [[1, 0], [-1, 0]], [1, 1]), [0, 0.7]),
    "equalities that differ": (DirectionProblem([5, 1], [[1, 0], [1, 0]], [1, 3], True), [2, 1]),
    "a zero row that asks for something": (DirectionProblem([1, 2], [[0, 0], [-1, 0]], [1, 0]), [0, 2]),
    "three walls round nothing": (
        DirectionProblem([4, 4, 4], [[1, 0, 0], [0, 1, 0], [-1, -1, 0]], [1, 1, 1]),
        [0.25, 0.25, 4],  # min (1 − x)² + (1 − y)² + ½(1 + x + y)²: the third row has length √2
    ),
}


@pytest.mark.parametrize("case", BY_HAND)
@pytest.mark.parametrize("solver", SOLVER)
def test_a_solver_finds_the_direction_that_a_pencil_finds(solver: DirectionSolver, case: str) -> None:
    problem, value, multipliers = BY_HAND[case]
    answer = solver.solve(problem)
    if not supports(solver, problem):
        assert answer.status == Status.UNSUPPORTED
        assert not answer.value.any()
        assert not answer.multipliers.any()
        return
    assert answer.status == Status.OPTIMAL
    assert kkt_residuals(problem, answer).worst <= tolerance_of(solver)
    np.testing.assert_allclose(answer.value, value, atol=1e-8)
    if multipliers is not None:
        np.testing.assert_allclose(answer.multipliers, multipliers, atol=1e-8)


@pytest.mark.parametrize("case", IMPOSSIBLE)
@pytest.mark.parametrize("solver", SOLVER)
def test_an_infeasible_problem_gets_its_proof_and_its_least_violation(solver: DirectionSolver, case: str) -> None:
    problem, value = IMPOSSIBLE[case]
    if not supports(solver, problem):
        return
    answer = solver.solve(problem)
    assert answer.status == Status.INFEASIBLE
    assert farkas_residual(problem, answer.multipliers) <= 1e-7
    np.testing.assert_allclose(answer.value, value, atol=1e-8)
    with pytest.raises(DirectionError, match="INFEASIBLE"):
        answer.raise_for_status()


def test_the_drop_rule_says_so_where_it_is_wrong() -> None:
    problem = DirectionProblem([-2, -2, -1], [[-1, -1, -2], [1, 0, 2], [-2, 0, -2]])
    dropped, exact = RosenDrop().solve(problem), Enumeration().solve(problem)
    np.testing.assert_allclose(exact.value, [-1.2, -2, 0.6], atol=1e-12)
    np.testing.assert_allclose(exact.multipliers, [0, 0.8, 0], atol=1e-12)
    assert dropped.status == Status.UNCERTIFIED
    np.testing.assert_allclose(dropped.value, [-2, -2, -1], atol=1e-12)  # everything was dropped
    assert kkt_residuals(problem, dropped).primal > 0.5


HARD = DirectionProblem([1.0, -2.0, 0.5, 1.0], [[-1, 0.3, 0, 0.2], [0.4, 1, 0.1, 0], [0, 0, -1, -0.7], [0.1, 1, -1, 0]])


@pytest.mark.parametrize("name", [name for name in ("osqp", *BACK_ENDS, "cvxpy") if is_installed(SOLVERS[name])])
def test_a_back_ends_own_multipliers_have_our_signs(name: str) -> None:
    problem = DirectionProblem([1, 1, 1], [[0, 0, 1], [-1, 0, 0], [0, 1, 0]], [2, 0, 0], [True, False, False])
    raw: DirectionSolver = dataclasses.replace(SOLVERS[name], polish=False)  # type: ignore[type-var]
    answer = raw.solve(problem)
    np.testing.assert_allclose(answer.value, [0, 1, 2], atol=1e-5)
    np.testing.assert_allclose(answer.multipliers, [1, 1, 0], atol=1e-5)


@pytest.mark.skipif(not is_installed(SOLVERS["highs"]), reason="HiGHS is not installed")
def test_a_back_end_that_stops_without_a_reason_is_not_certified() -> None:
    none = {"qp_iteration_limit": 0}  # with 1 it is done
    answer = QPSolversBackend("highs", options=none, polish=False).solve(HARD)
    assert answer.status in (Status.UNCERTIFIED, Status.NUMERICAL_ERROR)
    assert answer.status == Status.NUMERICAL_ERROR or kkt_residuals(HARD, answer).worst > 1e-8


@pytest.mark.parametrize("solver", SOLVER)
def test_an_answer_that_overflows_is_a_numerical_error_and_zeros(solver: DirectionSolver) -> None:
    problem = DirectionProblem([1, 2], [[1e-320, 0]], 1, not supports(solver, HARD))  # d₁ ≥ 1e320
    answer = solver.solve(problem)
    if supports(solver, problem):
        assert answer.status == Status.NUMERICAL_ERROR
    assert not answer.value.any()


def test_raw_multipliers_let_the_lengths_of_rows_choose_what_is_dropped() -> None:
    plain = DirectionProblem([0, -1], [[-2, 1], [1, -2]])
    longer = DirectionProblem([0, -1], [[-2, 1], [100, -200]])
    for problem in (plain, longer):
        np.testing.assert_allclose(RosenDrop().solve(problem).value, [-0.4, -0.8], atol=1e-15)
    as_printed = RosenDrop(raw_multipliers=True)
    np.testing.assert_allclose(as_printed.solve(plain).value, [-0.4, -0.8], atol=1e-15)
    assert as_printed.solve(longer).status == Status.UNCERTIFIED
