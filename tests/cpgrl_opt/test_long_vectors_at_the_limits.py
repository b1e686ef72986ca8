"""Long vectors where numbers leave float64, rows are off, and arrays are copied: each case was wrong once."""

import copy
import pickle

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, ConstrainedStep, Direction, DirectionProblem, Linearization, Status, kkt_residuals
from cpgrl_opt.vectors import _numpy

ACTIVE_SET = SOLVERS["active-set"]
E = np.eye(20)


@pytest.fixture(autouse=True)
def every_problem_is_long(monkeypatch):
    monkeypatch.setattr(_numpy, "LEAST_PRODUCTS", 0)


@pytest.mark.parametrize(
    ("gradient", "rows", "bound", "right"),
    [
        (E[0], [1e301 * E[0], E[0]], [-np.inf, 0.5], E[0]),
        (1e10 * (E[0] - E[1]), [1e300 * E[0], E[1]], [-np.inf, 0.0], 1e10 * E[0]),
        (E[0], [E[0] + E[1], E[0]], [-np.inf, 0.5], E[0]),
        (1e-10 * E[0], [E[0]], [1e300], 1e300 * E[0]),
        (E[0], [E[0]], [1e305], 1e305 * E[0]),
    ],
)
@pytest.mark.parametrize("errors", ["warn", "raise"])
def test_rows_that_are_off_and_huge_numbers_cost_no_answer_and_no_warning(gradient, rows, bound, right, errors):
    with np.errstate(all=errors):
        answer = ACTIVE_SET.solve(DirectionProblem(gradient, np.array(rows), bound))
    assert answer.status == Status.OPTIMAL
    np.testing.assert_allclose(answer.value, right, rtol=1e-12, atol=0)


def test_a_zero_row_that_asks_for_the_least_number_certifies_nothing():
    """0 · ∞ made NaN of the residual, which a maximum hides."""
    problem = DirectionProblem(1e130 * E[0], np.zeros((1, 20)), [1e-200])
    claim = Direction(problem.gradient, np.zeros(1), Status.OPTIMAL)
    assert kkt_residuals(problem, claim).worst == np.inf


def test_whether_nothing_is_left_of_the_gradient_is_told_alike_in_the_span_and_on_the_rows(monkeypatch):
    """PΔ¹ is 1e-9 long in ten thousand parts of 1e-11: no rotation may decide whether that is 0."""
    n = 10_000
    spread = np.full(n, 1.0 / np.sqrt(n - 1))
    spread[0] = 0.0
    first = np.zeros(n)
    first[0] = 1.0
    gradients = np.array([first + 1e-9 * spread, first])
    results = []
    for products in (0, 10**18):
        monkeypatch.setattr(_numpy, "LEAST_PRODUCTS", products)
        results.append(ConstrainedStep()(Linearization([0.0, 0.0], gradients), [0.1]))
    assert results[0].counts["dropped"] == results[1].counts["dropped"] == 0
    np.testing.assert_allclose(results[0].change, results[1].change, atol=1e-15)


def test_a_linearization_is_pickled_once_and_a_copied_problem_owns_its_arrays():
    gradients = np.random.default_rng(0).standard_normal((4, 300))
    linearization = Linearization(np.zeros(4), gradients)
    assert len(pickle.dumps(linearization)) < 1.2 * gradients.nbytes
    assert (pickle.loads(pickle.dumps(linearization)).gradients == gradients).all()
    problem = DirectionProblem(gradients[0], gradients[1:])
    assert np.shares_memory(problem.jacobian, gradients)
    assert not np.shares_memory(copy.copy(problem).jacobian, gradients)


def test_the_rows_are_named_where_no_rung_answers():
    problem = DirectionProblem(E[0] + E[2], [E[0], -E[0] + 1e-11 * E[1]], equality=True)
    assert {SOLVERS[name].solve(problem).rung for name in ("active-set", "nnls")} == {"rows"}
