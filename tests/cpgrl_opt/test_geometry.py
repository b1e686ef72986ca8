"""Metric and radius: closed forms, what every change of coordinates and units leaves, and honest infeasibility."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cpgrl_opt import SOLVERS, DirectionProblem, Status, farkas_residual, kkt_residuals
from cpgrl_opt.solvers import is_installed
from cpgrl_opt.testing import Case, problems_out_of_reach

SEEDS = st.integers(0, 2**32 - 1)
ACTIVE_SET = SOLVERS["active-set"]
INSTALLED = [name for name, solver in SOLVERS.items() if is_installed(solver)]
FAST = settings(max_examples=6)
# Solvers of each kind, and the constraints that they take.
SHIFTED = (Case.BOUNDS, Case.AFFINE, Case.MIXED)
OUT_OF_REACH = {"active-set": SHIFTED, "nnls": SHIFTED, "rosen": (Case.AFFINE,)}


def random_metric(rng, n, kind):
    if kind == "vector":
        return 10.0 ** rng.uniform(-2, 2, n)
    root = rng.standard_normal((n, n)) * 10.0 ** rng.uniform(-1, 1, n)
    return root @ root.T + 1e-2 * np.diag(np.diag(root @ root.T))


def as_matrix(metric, n):
    if metric is None:
        return np.eye(n)
    return np.diag(metric) if np.ndim(metric) == 1 else np.asarray(metric)


def random_problem(seed, n=4, m=3, *, kind="matrix", radius=None, bound=0.0, equality=False):
    rng = np.random.default_rng(seed)
    metric = None if kind is None else random_metric(rng, n, kind)
    g, J = rng.standard_normal(n), rng.standard_normal((m, n))
    return DirectionProblem(g, J, bound * rng.standard_normal(m), equality, metric, radius)


def certified(problem, solver=ACTIVE_SET):
    answer = solver.solve(problem)
    assert answer.status == Status.OPTIMAL, answer
    assert kkt_residuals(problem, answer).worst <= solver.tolerance
    return answer


def length(problem, d):
    return np.sqrt(d @ as_matrix(problem.metric, problem.n) @ d)


@pytest.mark.parametrize("kind", ["vector", "matrix"])
@given(seed=SEEDS)
@FAST
def test_with_equalities_the_metric_has_a_closed_form(kind, seed):
    """d = M⁻¹(g + Jᵀμ), JM⁻¹Jᵀμ = b − JM⁻¹g."""
    problem = random_problem(seed, kind=kind, bound=1.0, equality=True, m=2)
    M = as_matrix(problem.metric, 4)
    J, b, g = problem.jacobian, problem.bound, problem.gradient
    mu = np.linalg.solve(J @ np.linalg.solve(M, J.T), b - J @ np.linalg.solve(M, g))
    expected = np.linalg.solve(M, g + J.T @ mu)
    for name in ("active-set", "rosen"):
        answer = certified(problem, SOLVERS[name])
        assert length(problem, answer.value - expected) <= 1e-8 * length(problem, expected)
        np.testing.assert_allclose(answer.multipliers, mu, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("kind", [None, "vector", "matrix"])
@given(seed=SEEDS)
@FAST
def test_without_bounds_the_ball_only_sets_the_length(kind, seed):
    cone, ball = (random_problem(seed, kind=kind, radius=radius) for radius in (None, 0.7))
    projection, answer = certified(cone).value, certified(ball)
    size = length(cone, projection)
    if size > 1e-6:
        assert length(ball, answer.value - 0.7 * projection / size) <= 1e-9
        assert answer.radius_multiplier == pytest.approx(size / 0.7, rel=1e-9)


@pytest.mark.parametrize("radius", [None, 0.5, 3.0])
@pytest.mark.parametrize("bound", [0.0, 0.5])
@given(seed=SEEDS)
@FAST
def test_a_metric_is_a_change_of_coordinates(bound, radius, seed):
    """d ↦ Tᵀd, g ↦ T⁻¹g, J ↦ JT⁻ᵀ, M ↦ T⁻¹MT⁻ᵀ for any invertible T, here a rotation and new units."""
    problem = random_problem(seed, bound=bound, radius=radius)
    rng = np.random.default_rng(seed)
    T = np.linalg.qr(rng.standard_normal((4, 4)))[0] * 10.0 ** rng.uniform(-1, 1, 4)
    inverse = np.linalg.inv(T)
    metric = inverse @ problem.metric @ inverse.T
    other = DirectionProblem(
        inverse @ problem.gradient,
        problem.jacobian @ inverse.T,
        problem.bound,
        False,
        0.5 * (metric + metric.T),
        radius,
    )
    one, two = ACTIVE_SET.solve(problem), ACTIVE_SET.solve(other)
    assert one.status == two.status
    scale = length(problem, one.value) + length(other, two.value)
    assert length(other, two.value - T.T @ one.value) <= 1e-5 * scale
    measured = (kkt_residuals(p, a) for p, a in ((problem, one), (other, two)))
    if one.status == Status.OPTIMAL:
        assert max(each.worst for each in measured) <= 1e-9


@pytest.mark.parametrize("scale", [1e-100, 1e-12, 1e12, 1e100])
@pytest.mark.parametrize("what", ["gradient", "rows", "lengths", "metric"])
def test_units_decide_nothing(scale, what):
    for seed in range(10):
        p = random_problem(seed, bound=0.3, radius=1.0)
        reference = ACTIVE_SET.solve(p)
        factors = {"gradient": scale if what == "gradient" else 1.0, "rows": scale if what == "rows" else 1.0}
        long, heavy = scale if what == "lengths" else 1.0, scale if what == "metric" else 1.0
        other = DirectionProblem(
            factors["gradient"] * p.gradient,
            factors["rows"] * p.jacobian,
            factors["rows"] * p.bound * long,
            False,
            heavy * p.metric,
            p.radius * long * np.sqrt(heavy),
        )
        answer = ACTIVE_SET.solve(other)
        assert answer.status == reference.status
        np.testing.assert_allclose(answer.value / long, reference.value, rtol=1e-8, atol=1e-10)
        if answer.status == Status.OPTIMAL:
            assert kkt_residuals(other, answer).worst <= 1e-12


@given(seed=SEEDS)
@FAST
def test_a_small_ball_is_told_from_a_large_one(seed):
    """The ball meets {Jd ≥ b} where radius ≥ the length of the shortest d, the projection of 0."""
    cone = random_problem(seed, bound=1.0)
    shortest = ACTIVE_SET.solve(DirectionProblem(np.zeros(4), cone.jacobian, cone.bound, False, cone.metric)).value
    size = length(cone, shortest)
    if size == 0.0:
        return
    for factor in (0.2, 0.999, 1.001, 5.0):
        problem = DirectionProblem(cone.gradient, cone.jacobian, cone.bound, False, cone.metric, factor * size)
        answer = ACTIVE_SET.solve(problem)
        assert answer.status == (Status.INFEASIBLE if factor < 1.0 else Status.OPTIMAL)
        if factor < 1.0:
            assert farkas_residual(problem, answer.multipliers) <= 1e-6
            assert length(problem, answer.value) == pytest.approx(problem.radius, rel=1e-9)


def violation(problem, d):
    """‖r‖, r = b̂ − Ĵd (its positive part on I) on rows of length 1 in the metric, and M⁻¹Ĵᵀr, down which it falls."""
    inverse = np.linalg.inv(as_matrix(problem.metric, problem.n))
    sizes = np.sqrt(np.einsum("ij,jk,ik->i", problem.jacobian, inverse, problem.jacobian))
    assert (problem.bound[sizes == 0] <= 0).all()
    lack = np.where(sizes > 0, problem.bound - problem.jacobian @ d, 0.0) / np.where(sizes > 0, sizes, 1.0)
    lack = np.where(problem.equality, lack, np.maximum(lack, 0.0))
    return np.linalg.norm(lack), inverse @ (lack / np.where(sizes > 0, sizes, 1.0) @ problem.jacobian)


@pytest.mark.parametrize("name", [name for name in OUT_OF_REACH if name in INSTALLED])
@given(data=st.data(), seed=SEEDS)
@settings(max_examples=15)
def test_where_the_ball_misses_no_point_of_it_violates_less(name, data, seed):
    """Neither down the slope of the violation nor around d, each point pulled back into the ball."""
    solver, rng = SOLVERS[name], np.random.default_rng(seed)
    problem = data.draw(problems_out_of_reach(OUT_OF_REACH[name]))
    answer = solver.solve(problem)
    assert answer.status == Status.INFEASIBLE
    assert length(problem, answer.value) <= problem.radius * (1 + 1e-8)
    least, slope = violation(problem, answer.value)
    assert least > 0
    steps = [slope * size for size in (1e-3, 1e-1, 1.0)]
    steps += [problem.radius * 10.0 ** rng.uniform(-4, 0) * rng.standard_normal(problem.n) for _ in range(20)]
    for step in steps:
        other = answer.value + step
        other *= min(1.0, problem.radius / (length(problem, other) or 1.0))
        assert violation(problem, other)[0] >= least * (1 - 1e-7)


def test_contradictory_rows_in_a_ball_are_infeasible_and_the_best_climb_of_those_that_violate_least():
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0], [-1.0, 0.0]], [0.5, 0.5], radius=1.0)
    answer = ACTIVE_SET.solve(problem)
    assert answer.status == Status.INFEASIBLE
    np.testing.assert_allclose(answer.value, [0.0, 1.0], atol=1e-12)
    assert farkas_residual(problem, answer.multipliers) <= 1e-12


@pytest.mark.parametrize("bound", [0.0, -1.0])
def test_without_a_gradient_the_shortest_direction_is_taken(bound):
    problem = DirectionProblem([0.0, 0.0], [[1.0, 0.0]], bound, radius=2.0)
    assert certified(problem).value.tolist() == [0.0, 0.0]
    asked = DirectionProblem([0.0, 0.0], [[1.0, 1.0]], 1.0, metric=[1.0, 4.0], radius=2.0)
    np.testing.assert_allclose(certified(asked).value, [0.8, 0.2], rtol=1e-14)


def test_a_ball_that_does_not_matter_leaves_the_shortest_of_the_best():
    """max d₁ s.t. d₁ ≤ 1: best wherever d₁ = 1, and shortest at (1, 0, 0)."""
    problem = DirectionProblem([2.0, 0.0, 0.0], [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [-1.0, -3.0], radius=50.0)
    answer = certified(problem)
    np.testing.assert_allclose(answer.value, [1.0, 0.0, 0.0], atol=1e-15)
    assert answer.radius_multiplier == 0.0
    vertex = DirectionProblem([1.0, 1.0], [[-1.0, 0.0], [0.0, -1.0]], [-1.0, -2.0], radius=1e9)
    np.testing.assert_allclose(certified(vertex).value, [1.0, 2.0], rtol=1e-14)
