"""The referee in a metric and in a ball: each residual by hand, no units, and no trick that passes."""

import numpy as np
import pytest

from cpgrl_opt import Direction, DirectionProblem, Status, farkas_residual, kkt_residuals

# max 3d₁ + 4d₂ s.t. d₂ ≤ 3, ‖d‖ ≤ 5: d = (4, 3), κ = ¾, 4 − μ = 3κ.
BALL = DirectionProblem([3.0, 4.0], [[0.0, -2.0]], [-6.0], radius=5.0)
OPTIMUM = ([4.0, 3.0], [0.875], 0.75)
GAMMA, LAMBDA = 5.0, 5.0  # ‖g‖; max(‖d‖, min(radius, |b̂|))


def residuals(problem, value, multipliers, kappa=0.0):
    return kkt_residuals(problem, Direction(np.array(value), np.array(multipliers), Status.OPTIMAL, 0, kappa))


def test_the_optimum_in_the_ball_has_no_residual():
    assert residuals(BALL, *OPTIMUM).worst <= 1e-16


@pytest.mark.parametrize(
    ("value", "multipliers", "kappa", "name", "amount"),
    [
        ([4.0, 3.0], [0.875], 0.5, "stationarity", 0.25 * 5.0 / GAMMA),
        ([4.0, 3.0], [0.375], 0.75, "stationarity", 1.0 / GAMMA),
        ([8.0, 6.0], [0.0], 0.5, "primal", 5.0 / 10.0),  # twice the radius; 10 is ‖d‖ now
        ([0.0, 5.0], [0.875], 0.75, "primal", 2.0 / LAMBDA),
        ([4.0, 3.0], [-0.5], 0.75, "dual", 1.0 / GAMMA),
        ([4.0, 3.0], [0.875], -0.75, "dual", 0.75 * LAMBDA / GAMMA),
        ([2.0, 3.0], [0.875], 0.75, "complementarity", (5.0 - np.sqrt(13.0)) / np.sqrt(13.0)),  # inside, but κ > 0
        ([4.0, 2.0], [0.875], 0.75, "complementarity", 1.0 / np.sqrt(20.0)),  # slack, but μ > 0
    ],
)
def test_each_residual_in_the_ball_is_its_formula(value, multipliers, kappa, name, amount):
    assert getattr(residuals(BALL, value, multipliers, kappa), name) == pytest.approx(amount, rel=1e-12)


@pytest.mark.parametrize("force", [1e-100, 1e-12, 1e100])
@pytest.mark.parametrize("unit", [1e-100, 1e12, 1e100])
def test_forces_and_lengths_have_units_of_their_own_in_a_ball(force, unit):
    scaled = DirectionProblem(force * BALL.gradient, BALL.jacobian, unit * BALL.bound, radius=unit * 5.0)
    wrong = ([4.0, 2.9], [0.8], 0.7)
    found = residuals(scaled, unit * np.array(wrong[0]), force * np.array(wrong[1]), wrong[2] * force / unit)
    expected = residuals(BALL, *wrong)
    for name in ("stationarity", "primal", "dual", "complementarity"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-9)


@pytest.mark.parametrize("scale", [1e-100, 1.0, 1e100])
def test_a_metric_is_measured_where_it_is_the_identity(scale):
    """Md = g + Jᵀμ: min d₁² + ½d₂² s.t. d₁ + d₂ ≥ 3 is at (1, 2), μ = 2."""
    problem = DirectionProblem([0.0, 0.0], [[1.0, 1.0]], 3.0, metric=scale * np.array([[2.0, 0.0], [0.0, 1.0]]))
    assert residuals(problem, [1.0, 2.0], [2.0 * scale]).worst <= 1e-15
    # d = (1, 1): lacks 1 of 3; rows are √(1/2 + 1) long, d is √(2 + 1), in the scale's units.
    assert residuals(problem, [1.0, 1.0], [0.0]).primal == pytest.approx(1.0 / np.sqrt(1.5) / np.sqrt(3.0), rel=1e-12)
    # Md − Jᵀμ = (−2, −1) for μ = 4, (−2, 0) with 4 and d₂ = 4: ‖·‖ in M⁻¹.
    assert residuals(problem, [1.0, 4.0], [4.0 * scale]).stationarity == pytest.approx(
        np.sqrt(2.0) / np.sqrt(18.0), rel=1e-12
    )


def test_rounding_of_a_direction_that_is_zero_is_no_violation():
    problem = DirectionProblem([-1.0, 0.0], [[1.0, 0.0]], radius=1.0)
    assert residuals(problem, [-1e-17, 0.0], [1.0]).worst <= 1e-16
    assert residuals(problem, [0.0, 0.0], [1.0]).worst == 0.0


@pytest.mark.parametrize("metric", [None, np.ones(2), np.eye(2)])
def test_no_force_at_all_needs_no_multiplier_and_any_that_is_there_is_judged(metric):
    problem = DirectionProblem([0.0, 0.0], [[1.0, 0.0]], 0.5, metric=metric, radius=1.0)
    assert residuals(problem, [0.5, 0.0], [0.0]).worst == 0.0
    assert residuals(problem, [0.5, 0.0], [1e-9]).stationarity > 0.1
    assert 1.0 <= residuals(problem, [0.0, 0.0], [0.0]).primal < np.inf
    assert residuals(problem, [0.5, 0.0], [0.0], 1e-9).stationarity == pytest.approx(0.5 / 0.5)  # κ‖d‖ over κλ
    slack = DirectionProblem([0.0, 0.0], [[1.0, 0.0]], -0.5, metric=metric, radius=1.0)
    assert residuals(slack, [0.0, 0.0], [0.0]).worst == 0.0
    assert residuals(slack, [0.0, 0.0], [1e9]).stationarity > 0.1


def test_what_proves_that_a_ball_misses():
    """bᵀy > radius ‖Jᵀy‖, in the metric's lengths of rows."""
    for radius, proven in ((0.9, True), (0.999999, True), (1.0, False), (1.1, False)):
        problem = DirectionProblem([1.0, 0.0], [[3.0, 4.0]], [5.0], radius=radius)
        assert (farkas_residual(problem, np.array([2.0])) <= 1e-6) == proven
        longer = DirectionProblem([1.0, 0.0], [[3.0, 4.0]], [5.0], metric=[4.0, 4.0], radius=2.0 * radius)
        assert (farkas_residual(longer, np.array([2.0])) <= 1e-6) == proven
    assert farkas_residual(DirectionProblem([1.0, 0.0], [[3.0, 4.0]], [5.0], radius=0.5), np.array([-1.0])) == np.inf


def test_neither_a_huge_radius_nor_a_huge_slack_bound_hides_a_violation():
    problem = DirectionProblem([1.0, 0.0], [[-1.0, 0.0], [0.0, 1.0]], [-1.0, -1e12], radius=1e12)
    assert residuals(problem, [1.0, 0.0], [1.0, 0.0]).worst == 0.0
    assert residuals(problem, [1.5, 0.0], [1.0, 0.0]).primal > 0.3
