"""With a full metric the referee measures with M itself, as exact rationals do, and nothing underflows on the way."""

from fractions import Fraction

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status, kkt_residuals

from .long import rational, solve_exactly

ACTIVE_SET = SOLVERS["active-set"]


def exact_stationarity(problem, answer):
    """‖κMd − g − Jᵀμ‖ in M⁻¹, in the referee's unit of forces; without the referee's allowance for rounding."""
    M, g, J = (rational(each) for each in (problem.metric, problem.gradient, problem.jacobian))
    d, mu = rational(answer.value), rational(answer.multipliers)
    kappa = Fraction(1) if problem.radius is None else Fraction(float(answer.radius_multiplier))
    force = kappa * (M @ d) - g - mu @ J
    inverse = solve_exactly(M, np.column_stack([force, g]))
    strength = float(g @ inverse[:, 1]) ** 0.5
    unit = strength if problem.radius is not None else max(strength, float(d @ M @ d) ** 0.5)
    return float(force @ inverse[:, 0]) ** 0.5 / unit


def ill_conditioned(seed, exponent, m=0, radius=None):
    """A problem whose M has eigenvalues from 1 down to 10^−exponent; g is a force, or the metric's of a direction."""
    rng = np.random.default_rng(seed)
    n = 2 + seed % 3
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    M = (Q * 10.0 ** -np.linspace(0, exponent, n)) @ Q.T
    M = 0.5 * (M + M.T)
    g, J = rng.standard_normal(n), rng.standard_normal((m, n))
    return DirectionProblem(M @ g if seed % 2 else g, J @ M if seed % 4 > 1 else J, metric=M, radius=radius)


@pytest.mark.parametrize("radius", [None, 0.7])
@pytest.mark.parametrize("exponent", [6, 9, 10, 12])
def test_answers_are_certified_and_stationarity_is_that_of_exact_rationals(exponent, radius):
    for seed in range(4):
        problem = ill_conditioned(seed, exponent, m=seed % 2, radius=radius)
        answer = ACTIVE_SET.solve(problem)
        assert answer.status == Status.OPTIMAL
        assert exact_stationarity(problem, answer) <= 1e-9
        wrong = Direction(answer.value * (1 + 1e-8), answer.multipliers, Status.OPTIMAL, 0, answer.radius_multiplier)
        for each in (answer, wrong):
            expected = exact_stationarity(problem, each)
            assert kkt_residuals(problem, each).stationarity == pytest.approx(expected, rel=0.05, abs=1e-12)


def test_a_row_that_whitening_would_underflow_is_still_asked_for():
    """Jd < 0 where Jd ≥ 0 is asked; JL⁻ᵀ is 1e-325."""
    for metric in ([1e60, 1e60], 1e60 * np.eye(2)):
        problem = DirectionProblem([-1.0, 0.0], [[1e-295, 0.0]], metric=metric)
        descending = Direction(np.array([-1e-60, 0.0]), np.zeros(1), Status.OPTIMAL)
        assert kkt_residuals(problem, descending).primal == pytest.approx(1.0)
        assert kkt_residuals(problem, Direction(np.zeros(2), np.array([1e295]), Status.OPTIMAL)).worst <= 1e-15


def test_solvers_see_rows_and_gradients_that_whitening_would_underflow():
    for metric in ([1e60, 1e60], 1e60 * np.eye(2)):
        problem = DirectionProblem([-1.0, 0.0], [[1e-295, 0.0]], metric=metric)
        for answer in (ACTIVE_SET.solve(problem), ACTIVE_SET.solve_batch([problem, problem])[1]):
            assert answer.status == Status.OPTIMAL
            np.testing.assert_array_equal(answer.value, [0.0, 0.0])
    climbing = ACTIVE_SET.solve(DirectionProblem([1e-300], np.zeros((0, 1)), metric=[1e60], radius=1.0))
    assert climbing.status != Status.OPTIMAL or climbing.value[0] == pytest.approx(1e-30)
