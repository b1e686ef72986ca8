"""The referee says the same of long vectors, in passes over them, as of their rows in memory."""

from contextlib import contextmanager

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.vectors import _numpy as array_vectors

ACTIVE_SET = SOLVERS["active-set"]
WIDE = np.random.default_rng(3).standard_normal((8, 300))


@pytest.fixture(autouse=True)
def every_problem_is_long(monkeypatch):
    monkeypatch.setattr(array_vectors, "LEAST_PRODUCTS", 0)


@contextmanager
def on_rows():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(array_vectors, "LEAST_PRODUCTS", 10**18)
        yield


def drawn_problem(seed, equality=False):
    """Rows well apart, about half of them tight at the optimum."""
    rng = np.random.default_rng(seed)
    return DirectionProblem(
        rng.standard_normal(80), rng.standard_normal((4, 80)), 0.2 * rng.standard_normal(4), equality
    )


def some_answers(problem):
    """Right, wrong in each way, with multipliers that all but cancel, and not finite."""
    right = ACTIVE_SET.solve(problem)
    d, mu = right.value, right.multipliers
    yield d, mu
    yield d + 1e-6 * problem.gradient, mu
    yield d, mu + 1e-6
    yield d, -mu - 1.0
    yield d, mu - (np.arange(len(mu)) == 1)
    yield np.zeros_like(d), np.zeros_like(mu)
    yield 1e160 * d, mu
    for size in (1e3, 1e9, 1e11, 1e15):
        yield d, mu + size * (np.arange(len(mu)) == 0)
        yield d + size * problem.jacobian[0] + problem.gradient, mu + size * (np.arange(len(mu)) == 0)
    for bad in (np.nan, np.inf):
        yield np.where(np.arange(len(d)) == 5, bad, d), mu
        yield d, np.where(np.arange(len(mu)) == 1, bad, mu)


PROBLEMS_TO_JUDGE = {
    "generic": lambda: drawn_problem(0, equality=[True, False, False, False]),
    "off": lambda: DirectionProblem(WIDE[0], WIDE[1:4], [0.3, -np.inf, -1.0]),
    "zero rows": lambda: DirectionProblem(WIDE[0], WIDE[1:4] * [[1.0], [0.0], [1.0]], [0.3, -1.0, 0.0]),
    "zero row that asks": lambda: DirectionProblem(WIDE[0], WIDE[1:4] * [[1.0], [0.0], [1.0]], [0.3, 1.0, 0.0]),
    "zero row that is off": lambda: DirectionProblem(WIDE[0], WIDE[1:4] * [[0.0], [1.0], [1.0]], [-np.inf, 1.0, 0.0]),
    "zero gradient": lambda: DirectionProblem(0 * WIDE[0], WIDE[1:4]),
    "row scales": lambda: DirectionProblem(WIDE[0], WIDE[1:4] * [[1e100], [1e-100], [1.0]], [1e100, 0.0, -1.0]),
    "beyond squares": lambda: DirectionProblem(WIDE[0], WIDE[1:4] * [[1e170], [1e-170], [1.0]], [1e170, 0.0, -1.0]),
    "small": lambda: DirectionProblem(1e-170 * WIDE[0], WIDE[1:4]),
    "opposing": lambda: DirectionProblem(WIDE[0], [WIDE[1], -WIDE[1], WIDE[2]]),
}


@pytest.mark.parametrize("name", PROBLEMS_TO_JUDGE)
def test_the_referee_says_the_same_of_long_problems_as_on_the_rows(name):
    problem = PROBLEMS_TO_JUDGE[name]()
    assert array_vectors.is_long(problem.m, problem.n)
    for d, mu in some_answers(problem):
        answer = Direction(d, mu, Status.OPTIMAL)
        found = kkt_residuals(problem, answer)
        with on_rows():
            expected = kkt_residuals(
                DirectionProblem(problem.gradient, problem.jacobian, problem.bound, problem.equality), answer
            )
        for part in ("stationarity", "primal", "dual", "complementarity"):
            assert getattr(found, part) == pytest.approx(getattr(expected, part), rel=1e-6, abs=2e-14), (part, mu)
