"""A metric in closed form, and units that decide nothing. Balls are held against an exact search elsewhere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cpgrl_opt import SOLVERS, DirectionProblem, Status, kkt_residuals


def draw(seed, m, kind, **more):
    """g, J, b and a metric of four parameters."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4)) * 10.0 ** rng.uniform(-1, 1, 4)
    M = root @ root.T + 1e-2 * np.diag(np.diag(root @ root.T))
    metric = M if kind == "matrix" else np.diag(M)
    return DirectionProblem(*map(rng.standard_normal, (4, (m, 4), m)), metric=metric, **more)


@pytest.mark.parametrize("kind", ["vector", "matrix"])
@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1))
def test_with_equalities_the_metric_has_a_closed_form(kind, seed):
    """d = M⁻¹(g + Jᵀμ), JM⁻¹Jᵀμ = b − JM⁻¹g."""
    problem = draw(seed, 2, kind, equality=True)
    M = problem.metric if kind == "matrix" else np.diag(problem.metric)
    J, b, g = problem.jacobian, problem.bound, problem.gradient
    mu = np.linalg.solve(J @ np.linalg.solve(M, J.T), b - J @ np.linalg.solve(M, g))
    expected = np.linalg.solve(M, g + J.T @ mu)
    for name in ("active-set", "rosen"):
        answer = SOLVERS[name].solve(problem)
        assert answer.status == Status.OPTIMAL
        assert kkt_residuals(problem, answer).worst <= SOLVERS[name].tolerance
        error = answer.value - expected
        assert error @ M @ error <= 1e-16 * (expected @ M @ expected)
        np.testing.assert_allclose(answer.multipliers, mu, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("scale", [1e-100, 1e-12, 1e12, 1e100])
@pytest.mark.parametrize("what", ["gradient", "rows", "lengths", "metric"])
def test_units_decide_nothing(scale, what):
    """Each of g, J and b, d, and M in other units."""
    force, rows, long, heavy = (scale if what == each else 1.0 for each in ("gradient", "rows", "lengths", "metric"))
    for seed in range(10):
        p = draw(seed, 3, "matrix", radius=2.0)
        radius = p.radius * long * np.sqrt(heavy)
        other = DirectionProblem(
            force * p.gradient, rows * p.jacobian, rows * p.bound * long, metric=heavy * p.metric, radius=radius
        )
        reference, answer = (SOLVERS["active-set"].solve(each) for each in (p, other))
        assert answer.status == reference.status
        np.testing.assert_allclose(answer.value / long, reference.value, rtol=1e-8, atol=1e-10)
        if answer.status == Status.OPTIMAL:
            assert kkt_residuals(other, answer).worst <= 1e-12
