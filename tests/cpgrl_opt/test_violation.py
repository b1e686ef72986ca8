"""What violates least and what a Farkas vector proves, by hand; and what of it makes an INFEASIBLE stand."""

from dataclasses import replace

import numpy as np
import pytest

from cpgrl_opt import Direction, DirectionProblem, Status, farkas_residual
from cpgrl_opt._violation import is_missed
from cpgrl_opt.certify import certify, excess_violation, least_violation_residual, misses_a_bound
from cpgrl_opt.solvers.infeasibility import infeasible_direction

OPPOSING = DirectionProblem([0.0, 0.0], [[0.0, 2.0], [0.0, -1.0]], [2.0, 1.0])  # d₂ ≥ 1 and d₂ ≤ −1
CLAIM = Direction(np.zeros(2), np.array([0.5, 1.0]), Status.INFEASIBLE)


def status_of(problem: DirectionProblem, claim: Direction, tolerance: float) -> Status:
    return certify(problem, claim, tolerance, infeasible_direction).status


def test_the_excess_violation_is_its_formula() -> None:
    """At (0, ½): r = (½, 3/2), Ĵᵀr = (0, −1), and s is ‖d‖, ‖g‖ or what is demanded, whichever is larger."""
    d = np.array([0.0, 0.5])
    for gradient, unit in (([0.0, 0.0], 1.0), ([3.0, 4.0], 5.0)):
        problem = DirectionProblem(gradient, OPPOSING.jacobian, OPPOSING.bound)
        assert excess_violation(problem, d) == pytest.approx(1.0 / unit, rel=1e-15)
        assert excess_violation(problem, np.array([0.0, 8.0])) == pytest.approx(9.0 / 8.0, rel=1e-15)
    assert least_violation_residual(OPPOSING, d) == pytest.approx(1.0 / np.sqrt(2.5), rel=1e-15)
    equality = DirectionProblem([0.0, 0.0], [[0.0, 1.0]], -2.0, equality=True)  # at 0: r = −2
    assert excess_violation(equality, np.zeros(2)) == 1.0


def test_the_excess_violation_in_a_ball_is_that_of_a_step_which_stays_in_it() -> None:
    problem = DirectionProblem([9.0, 0.0], [[0.0, 1.0]], 3.0, radius=0.5)  # s is the radius, g is no length
    assert excess_violation(problem, np.zeros(2)) == 1.0
    assert excess_violation(problem, np.array([0.0, 0.5])) == 0.0
    assert excess_violation(problem, np.array([0.0, 2.0])) == pytest.approx(3.0, rel=1e-15)  # out of it by 1.5
    large = DirectionProblem([9.0, 0.0], [[0.0, 1.0]], 3.0, radius=8.0)  # s = 3
    assert excess_violation(large, np.array([0.0, 1.0])) == pytest.approx(2.0 / 3.0, rel=1e-15)


@pytest.mark.parametrize("metric", [None, np.ones(2), np.eye(2)])
def test_the_farkas_residual_is_its_formula(metric) -> None:
    """ŷ = (1, ½) on unit rows: Ĵᵀŷ = (0, ½), b̂ᵀŷ = 3/2. With (1, 1, −1/5) the sign is what is wrong."""
    problem = DirectionProblem([1.0, 0.0], OPPOSING.jacobian, OPPOSING.bound, metric=metric)
    assert farkas_residual(problem, np.array([0.5, 0.5])) == pytest.approx(0.5 / 1.5, rel=1e-15)
    rows = np.array([[0.0, 1.0], [0.0, -1.0], [0.0, 0.0]])
    three = DirectionProblem([1.0, 0.0], [[1.0, 0.0], *rows[:2]], [0.1, 1.0, 1.0], metric=metric)
    assert farkas_residual(three, np.array([-0.2, 1.0, 1.0])) == pytest.approx(0.2 / (2.0 - 0.02), rel=1e-15)
    off = DirectionProblem([1.0, 0.0], rows[:2], [1.0, -np.inf], metric=metric)
    assert farkas_residual(off, np.ones(2)) == np.inf
    zero = DirectionProblem([1.0, 0.0], rows, [0.0, 0.0, -3.0], [False, False, True], metric=metric)
    assert farkas_residual(zero, np.array([0.0, 0.0, -1.0])) == 0.0  # 0ᵀd = −3
    assert farkas_residual(zero, np.array([0.0, 0.0, 1.0])) == np.inf


def test_a_proof_that_the_ball_misses_has_the_sign_and_the_digits_that_it_needs() -> None:
    rows, bound = [[1.0, 0.0], [0.0, 1.0]], [2.0, -1.0]
    problem = DirectionProblem([1.0, 0.0], rows, bound, radius=1.0)  # d₁ ≥ 2
    assert farkas_residual(problem, np.array([1.0, 0.0])) <= 4e-15
    assert farkas_residual(problem, np.array([1.0, -0.3])) >= 0.2
    touching = DirectionProblem([1.0, 0.0], rows, bound, radius=2.0 * (1 - 2.0**-50))  # by what rounding leaves of b̂
    assert farkas_residual(touching, np.array([1.0, 0.0])) >= 0.5


def test_only_a_proof_makes_an_infeasible_stand() -> None:
    assert status_of(OPPOSING, CLAIM, 1e-6) == Status.INFEASIBLE
    for multipliers in ([0.5, 0.5], [-0.5, -1.0], [0.5, 0.0], [np.nan, 1.0]):
        assert status_of(OPPOSING, replace(CLAIM, multipliers=np.array(multipliers)), 1e-6) == Status.UNCERTIFIED
    for value in ([0.0, 1e-3], [np.nan, 0.0]):
        assert status_of(OPPOSING, replace(CLAIM, value=np.array(value)), 1e-6) == Status.UNCERTIFIED


def test_a_violation_that_is_small_beside_a_long_gradient_makes_no_infeasible_stand() -> None:
    """d = (0, 1e4) meets both rows and is short beside g; y proves that no shorter one does."""
    problem = DirectionProblem([1e6, 0.0], [[1.0, 1e-4], [-1.0, 1e-4]], 1.0)
    claim = Direction(np.zeros(2), np.ones(2), Status.INFEASIBLE)
    assert farkas_residual(problem, claim.multipliers) <= 1e-3
    assert excess_violation(problem, claim.value) <= 1e-9
    assert status_of(problem, claim, 1e-6) == Status.UNCERTIFIED


@pytest.mark.parametrize("radius", [1e-3, 1e9])
def test_a_proof_as_good_as_the_tolerance_stands_in_balls_of_any_size(radius) -> None:
    problem = DirectionProblem([1.0, 0.0], OPPOSING.jacobian, OPPOSING.bound, radius=radius)
    claim = replace(CLAIM, value=np.array([0.1, 0.0]) * min(radius, 1.0), multipliers=np.array([0.5, 1.00001]))
    assert status_of(problem, claim, 1e-6) == Status.INFEASIBLE


def test_a_bound_is_missed_by_more_than_rounding_in_its_own_unit() -> None:
    for size in (1e-12, 1.0, 1e12):
        problem = DirectionProblem([1.0, 0.0], [[0.0, 2.0], [1.0, 0.0]], [2.0 * size, -np.inf])
        assert misses_a_bound(problem, np.array([5.0, size * (1 - 1e-8)]))
        assert not misses_a_bound(problem, np.array([5.0, size * (1 - 1e-10)]))
    assert not misses_a_bound(DirectionProblem([1.0, 0.0], [[0.0, 1.0]]), np.array([0.0, -5.0]))  # b = 0 has no unit
    one_run_of_two = np.array([[0.0], [-0.5]])
    assert is_missed(np.ones((2, 1)), one_run_of_two, False)
    assert not is_missed(np.ones((2, 1)), 0.0 * one_run_of_two, False)
