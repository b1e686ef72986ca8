"""The referee measures what design says it measures, whatever the scale, and is fooled by none of the known tricks."""

from itertools import product

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status, farkas_residual, kkt_residuals
from cpgrl_opt.certify import certified_residuals
from cpgrl_opt.vectors import Certificate

PROBLEM = DirectionProblem([1.0, -2.0], [[0.0, 3.0], [2.0, 0.0]], bound=[0.0, -5.0])
OPTIMUM = ([1.0, 0.0], [2.0 / 3.0, 0.0])  # g pushed along the first row until it no longer points down


def residuals(problem, value, multipliers):
    return kkt_residuals(problem, Direction(np.array(value), np.array(multipliers), Status.OPTIMAL))


def test_the_optimum_has_no_residual():
    assert residuals(PROBLEM, *OPTIMUM).worst <= 1e-16


@pytest.mark.parametrize(
    ("value", "multipliers", "name", "amount"),
    [  # σ = max(‖g‖, ‖d‖), ‖g‖ = √5
        ([1.0, -0.1], [1.9 / 3.0, 0.0], "primal", 0.1 / np.sqrt(5)),
        ([1.0, 0.0], [0.0, 0.0], "stationarity", 2.0 / np.sqrt(5)),
        ([1.0, -2.5], [-0.5 / 3.0, 0.0], "dual", 0.5 / np.hypot(1.0, 2.5)),
        ([1.0, 0.2], [2.2 / 3.0, 0.0], "complementarity", 0.2 / np.sqrt(5)),
    ],
)
def test_each_residual_is_its_formula(value, multipliers, name, amount):
    found = getattr(residuals(PROBLEM, value, multipliers), name)
    assert found == pytest.approx(amount, rel=1e-12)


def test_an_equality_may_have_a_multiplier_of_either_sign():
    problem = DirectionProblem([1.0, 2.0], [[0.0, 1.0]], equality=True)
    assert residuals(problem, [1.0, 0.0], [-2.0]).worst <= 1e-16
    assert residuals(problem, [1.0, 0.5], [-1.5]).primal == pytest.approx(0.5 / np.sqrt(5))


def test_not_finite_is_infinitely_wrong():
    assert residuals(PROBLEM, [np.nan, 0.0], [0.0, 0.0]).worst == np.inf
    assert residuals(PROBLEM, [1.0, 0.0], [np.inf, 0.0]).worst == np.inf


def test_nothing_to_climb_and_nothing_violated_is_optimal_at_zero():
    jacobian = [[1.0, 0.0]]
    assert residuals(DirectionProblem([0.0, 0.0], jacobian), [0.0, 0.0], [0.0]).worst == 0.0
    assert residuals(DirectionProblem([0.0, 0.0], jacobian, bound=1.0), [0.0, 0.0], [0.0]).primal == np.inf
    for bound, equality, primal in ((-1.0, True, np.inf), (-1.0, False, 0.0), (0.0, True, 0.0)):
        found = residuals(DirectionProblem([0.0, 0.0], jacobian, bound, equality), [0.0, 0.0], [0.0])
        assert (found.primal, found.complementarity) == (primal, 0.0)


def test_a_zero_row_that_asks_for_more_than_zero_is_violated():
    problem = DirectionProblem([1.0, 0.0], [[0.0, 0.0]], bound=1e-3)
    assert residuals(problem, [1.0, 0.0], [0.0]).primal == np.inf
    assert residuals(DirectionProblem([1.0, 0.0], [[0.0, 0.0]], bound=-1.0), [1.0, 0.0], [0.0]).worst == 0.0


def test_a_farkas_vector_is_told_from_one_that_proves_nothing():
    opposing = DirectionProblem([1.0, 0.0], [[2.0, 0.0], [-1.0, 0.0]], bound=[1.0, 1.0])
    assert farkas_residual(opposing, np.array([1.0, 2.0])) <= 1e-16
    assert farkas_residual(opposing, np.array([1e-200, 2e-200])) <= 1e-16
    assert farkas_residual(opposing, np.array([1.0, 1.0])) > 0.1
    assert farkas_residual(opposing, np.array([-1.0, -2.0])) == np.inf
    assert farkas_residual(opposing, np.zeros(2)) == np.inf
    impossible = DirectionProblem([1.0, 0.0], [[0.0, 0.0], [1.0, 0.0]], bound=[1.0, 0.0])
    assert farkas_residual(impossible, np.array([1.0, 0.0])) == 0.0


@pytest.mark.parametrize("status", list(Status))
def test_only_optimal_passes_and_every_status_advises(status):
    direction = Direction(np.zeros(2), np.zeros(2), status)
    if status is Status.OPTIMAL:
        direction.raise_for_status()
    else:
        with pytest.raises(RuntimeError, match=status.name):
            direction.raise_for_status()
    assert len(status.advice) > 20


@pytest.mark.parametrize("radius", [None, 5.0])
@pytest.mark.parametrize("equality", [True, False])
def test_multipliers_that_cancel_to_rounding_certify_nothing(equality: bool, radius: float | None) -> None:
    sign = 1.0 if equality else -1.0
    rows = np.array([[0.6, 0.8], [sign * 0.6, sign * 0.8]])
    problem = DirectionProblem([-0.6, 1.2], rows, 0.0, equality, radius=radius)
    wrong, right = np.array([-1.6, 1.2]), np.array([-0.96, 0.72])
    kappa = 0.0 if radius is None else 1.0
    for size, shift in product((1e11, 7.35e15, 1e200, 1.7e308), (0.0, 1.0, -1.0, 2.0)):
        mu = np.array([size + shift, -sign * size])
        assert kkt_residuals(problem, answer(wrong, mu, kappa)).worst > 0.1
    lucky = DirectionProblem([-0.6000000000000001, 1.1999999999999997], rows, 0.0, equality, radius=radius)
    mu = np.array([7352240127454189.0, -sign * 7352240127454191.0])  # found by search: rounding stood for the rest
    assert kkt_residuals(lucky, answer(wrong, mu, kappa)).worst > 0.1
    exact = np.array([0.0, -sign * 0.6])
    if radius is None:
        assert kkt_residuals(problem, answer(right, exact, kappa)).worst < 1e-15
        large = answer(right, exact + 2.0**40 * np.array([1.0, -sign]), kappa)  # exact, and large
        assert kkt_residuals(problem, large).worst < 1e-4


def answer(value: np.ndarray, multipliers: np.ndarray, radius_multiplier: float) -> Direction:
    return Direction(value, multipliers, Status.OPTIMAL, radius_multiplier=radius_multiplier)


@pytest.mark.parametrize("geometry", ["none", "diagonal metric", "full metric", "ball"])
@pytest.mark.parametrize("size", [1e6, 1e8, 1e10])
def test_multipliers_that_cancel_excuse_no_error_outside_the_span_of_their_rows(size, geometry):
    """μ = (size, size) on opposing rows cancels; d is off by 9e-6 at a right angle to both: rounding explains none."""
    metric = {"diagonal metric": np.array([4.0, 1.0]), "full metric": np.array([[4.0, 0.0], [0.0, 1.0]])}.get(geometry)
    radius, kappa = (1.0, 1.0) if geometry == "ball" else (None, 0.0)
    problem = DirectionProblem([0.0, 1.0], [[1.0, 0.0], [-1.0, 0.0]], 0.0, metric=metric, radius=radius)
    wrong, right = np.array([9e-6, 1.0]) if geometry == "ball" else np.array([0.0, 1.000009]), np.array([0.0, 1.0])
    mu = np.array([size, size])
    if geometry != "ball":  # in a ball d is in the span, and its first part is one of the rows'
        assert kkt_residuals(problem, answer(wrong, mu, kappa)).stationarity == pytest.approx(9e-6, rel=1e-3)
    assert kkt_residuals(problem, answer(right, mu, kappa)).worst <= 1e-12


def test_a_multiplier_of_a_row_that_is_off_is_wrong_in_a_certificate_too():
    problem = DirectionProblem([1.0, 0.0], [[0.0, 1.0]], -np.inf)  # d = g + 2J
    seen = Certificate(0.0, np.array([2.0]), np.sqrt(5.0))
    found = certified_residuals(seen, problem, np.array([2.0]), np.array([1.0, 0.0]))
    assert found.complementarity == pytest.approx(2.0 / np.sqrt(5.0))
    assert (found.stationarity, found.primal, found.dual) == (0.0, 0.0, 0.0)


def test_in_a_ball_the_part_along_d_may_be_rounding_too():
    problem = DirectionProblem([0.0, 1.0], [[1.0, 0.0], [-1.0, 0.0]], radius=1.0)
    for size, least, most in ((1e9, 0.0, 1e-15), (1.0, 9e-7, 11e-7)):  # 8 eps Σ|μ̂| is 3.6e-6, and nothing
        found = kkt_residuals(problem, answer(np.array([0.0, 1.0]), np.array([size, size]), 1.0 + 1e-6))
        assert least <= found.stationarity <= most
    alone = DirectionProblem([1.0, 0.0], np.zeros((0, 2)), radius=1.0)  # κ̂ = 1e9, far inside the ball
    inside = answer(np.array([1e-9 * (1 + 1e-8), 0.0]), np.zeros(0), 1e9)
    assert kkt_residuals(alone, inside).stationarity <= 1e-15


@pytest.mark.parametrize("radius", [None, 1e308])
def test_lengths_beyond_float64_hide_no_error(radius):
    problem = DirectionProblem([1.5e308, 1.5e308], [[1.0, 0.0]], equality=True, radius=radius)
    assert kkt_residuals(problem, answer(problem.gradient, np.zeros(1), 1.0)).primal >= 0.5
    if radius is None:
        right = answer(np.array([0.0, 1.5e308]), np.array([-1.5e308]), 0.0)
        assert kkt_residuals(problem, right).worst <= 1e-15


def test_rows_that_oppose_each_other_but_for_rounding_span_one_direction():
    """μ leaves nothing to be excused at a right angle to them, though Ĵ has two singular values, √2 and 4e-17."""
    rows = np.array([[0.1, 0.3], [-0.3, -0.9]])
    across = np.array([0.3, -0.1]) / np.sqrt(0.1)
    problem = DirectionProblem(across, rows)
    found = kkt_residuals(problem, answer(across * 1.000009, np.array([3e9, 1e9]), 0.0))
    assert found.stationarity == pytest.approx(9e-6, rel=1e-2)


def test_rounding_of_multipliers_is_allowed_no_more_than_1e_5_along_their_rows():
    """μ = (1e14, 1e14) has digits of 1/64, and more than 0.1 of r might be these; d is off by 0.1 along the rows."""
    problem = DirectionProblem([0.0, 1.0], [[1.0, 0.0], [-1.0, 0.0]])
    found = kkt_residuals(problem, answer(np.array([0.1, 1.0]), np.array([1e14, 1e14]), 0.0))
    assert found.stationarity == pytest.approx((0.1 - 1e-5) / np.hypot(0.1, 1.0), rel=1e-4)


def test_multipliers_too_large_to_be_judged_certify_nothing():
    problem = DirectionProblem([0.0, 1.0], [[1.0, 0.0], [-1.0, 0.0]])
    for size, least, most in ((1e15, 0.0, 1e-12), (1e25, 1e-6, np.inf), (1e300, 1e-6, np.inf)):
        found = kkt_residuals(problem, answer(np.array([0.0, 1.0]), np.array([size, size]), 0.0))
        assert least <= found.stationarity <= most


def test_the_referee_measures_where_length_over_unit_leaves_float64():
    problem = DirectionProblem([-1e-155], [[1e155]])
    direction = SOLVERS["active-set"].solve(problem)
    assert direction.value == [0.0]
    assert kkt_residuals(problem, direction).worst <= 1e-12
    assert kkt_residuals(problem, answer(np.array([-1e-155]), np.zeros(1), 0.0)).primal == pytest.approx(1.0)
