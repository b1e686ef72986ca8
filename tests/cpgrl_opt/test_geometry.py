"""Metric and radius: closed forms, what every change of coordinates and units leaves, and honest infeasibility."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cpgrl_opt import SOLVERS, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.solvers import is_installed
from cpgrl_opt.testing import Case

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
