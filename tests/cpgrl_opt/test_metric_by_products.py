"""A metric known by its products alone, v ↦ Mv: the same answers, certified with M itself, and honest limits."""

from typing import Any

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator

from cpgrl_opt import (
    SOLVERS,
    ConstrainedStep,
    Direction,
    DirectionError,
    DirectionProblem,
    Linearization,
    ProblemBatch,
    Status,
    farkas_residual,
    kkt_residuals,
)
from cpgrl_opt.problems import draw_problem

ACTIVE_SET = SOLVERS["active-set"]


class Products:
    """v ↦ Mv, and how often it was asked."""

    def __init__(self, matrix: Any) -> None:
        self.matrix, self.asked = np.asarray(matrix), 0

    def __call__(self, vector: np.ndarray) -> np.ndarray:
        self.asked += 1
        return self.matrix @ vector


def fisher(rng: np.random.Generator, n: int) -> np.ndarray:
    root = rng.standard_normal((n, n))
    return np.asarray(root @ root.T + 0.1 * np.eye(n))


FAMILIES = ("ordinary", "duplicate rows", "opposing rows", "sum to zero", "binding", "infeasible", "in a ball")


def draw(seed: int) -> tuple[np.ndarray, dict[str, Any]]:
    """M and a problem's other arguments, with dependent and contradicting rows, stationary points, balls."""
    rng = np.random.default_rng(seed)
    problem = draw_problem(FAMILIES[seed % 7], rng, n=2 + seed % 6)
    names = ("gradient", "jacobian", "bound", "equality", "radius")
    return fisher(rng, problem.n), {name: getattr(problem, name) for name in names}


def agree(by_matrix: Direction, by_products: Direction, size: float) -> None:
    assert by_products.status == by_matrix.status
    np.testing.assert_allclose(by_products.value, by_matrix.value, rtol=1e-8, atol=1e-8 * size)


@pytest.mark.parametrize("seed", range(30))
def test_products_give_the_directions_of_the_matrix(seed: int) -> None:
    M, arguments = draw(seed)
    by_matrix, by_products = (DirectionProblem(**arguments, metric=metric) for metric in (M, Products(M)))
    answer = ACTIVE_SET.solve(by_products)
    agree(ACTIVE_SET.solve(by_matrix), answer, float(np.abs(by_matrix.gradient).max()))
    if answer.status == Status.OPTIMAL:
        assert kkt_residuals(by_products, answer).worst <= 1e-9
        assert kkt_residuals(by_matrix, answer).worst <= 1e-8
    if answer.status == Status.INFEASIBLE:
        assert farkas_residual(by_matrix, answer.multipliers) <= 1e-5


def test_residuals_are_those_of_the_matrix_for_wrong_answers_too() -> None:
    for seed in range(20):
        M, arguments = draw(seed)
        rng = np.random.default_rng(seed)
        d, mu = rng.standard_normal(len(M)), rng.standard_normal(len(arguments["bound"]))
        answer = Direction(d, mu, Status.OPTIMAL, 0, 0.7)
        expected, found = (
            kkt_residuals(DirectionProblem(**arguments, metric=metric), answer) for metric in (M, Products(M))
        )
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-9)


def test_a_hundred_thousand_parameters_without_a_matrix() -> None:
    """M = diag + low rank; n × n numbers would be 80 GB."""
    rng = np.random.default_rng(2)
    n = 100_000
    diagonal, low = rng.uniform(0.5, 2.0, n), rng.standard_normal((2, n)) / np.sqrt(n)
    M = LinearOperator((n, n), matvec=lambda v: diagonal * v + low.T @ (low @ v), dtype=np.float64)
    g, J = rng.standard_normal(n), rng.standard_normal((3, n))
    for radius in (None, 3.0):
        problem = DirectionProblem(g, J, [0.1, -5.0, 0.2], metric=M, radius=radius)
        answer = ACTIVE_SET.solve(problem)
        assert answer.status == Status.OPTIMAL
        force = (1.0 if radius is None else answer.radius_multiplier) * M.matvec(answer.value)
        np.testing.assert_allclose(force, g + answer.multipliers @ J, atol=1e-9)
        assert (J @ answer.value >= np.array([0.1, -5.0, 0.2]) - 1e-9).all()


def test_too_few_iterations_are_uncertified_and_never_more() -> None:
    rng = np.random.default_rng(4)
    M, g, J = np.diag(10.0 ** np.linspace(-3, 3, 40)), rng.standard_normal(40), rng.standard_normal((2, 40))
    problem = DirectionProblem(g, J, metric=Products(M), metric_iterations=3)
    assert ACTIVE_SET.solve(problem).status == Status.UNCERTIFIED
    right = ACTIVE_SET.solve(DirectionProblem(g, J, metric=M))
    assert right.status == Status.OPTIMAL
    assert not kkt_residuals(problem, right).worst <= 1e-9  # M⁻¹ measures what is left, and is not reached
    assert ACTIVE_SET.solve(DirectionProblem(g, J, metric=Products(M))).status == Status.OPTIMAL


def turned(vector: np.ndarray) -> np.ndarray:
    return np.array([vector[0] + 0.5 * vector[1], -0.5 * vector[0] + vector[1]])


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        (turned, "metric should be symmetric; found uᵀMv"),
        (lambda v: -v, "metric should be positive definite; found vᵀMv"),
        (lambda v, w: v + w, "metric should be a function of one vector; found"),
        (lambda v: v[:1], r"metric should return 2 finite numbers; found shape \(1,\)"),
        (LinearOperator((3, 3), matvec=lambda v: v, dtype=float), r"metric should have shape \(2, 2\); found \(3, 3\)"),
    ],
)
def test_what_is_no_metric_is_refused(metric: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DirectionProblem([1.0, 2.0], [[1.0, 0.0]], metric=metric)
    with pytest.raises(ValueError, match=message):
        ConstrainedStep(metric=metric)(Linearization([0.0, 0.0], [[1.0, 2.0], [1.0, 0.0]]), [1.0])


def test_an_indefinite_metric_is_refused_where_it_shows() -> None:
    M = np.diag([1.0] * 20 + [-1e-3])  # the two probes do not show it
    problem = DirectionProblem(np.eye(21)[20], np.zeros((0, 21)), metric=Products(M))
    with pytest.raises(ValueError, match="metric should be positive definite; found vᵀMv"):
        ACTIVE_SET.solve(problem)


def test_a_batch_has_one_metric_for_all_or_one_each() -> None:
    rng = np.random.default_rng(5)
    M, g, J = fisher(rng, 4), rng.standard_normal((3, 4)), rng.standard_normal((3, 2, 4))
    alone = [ACTIVE_SET.solve(DirectionProblem(*each, metric=M, radius=0.8)) for each in zip(g, J, strict=True)]
    for metric in (M[None], np.stack([M] * 3), Products(M)):
        batch = ProblemBatch(g, J, metric=metric, radius=0.8)
        for answers in (ACTIVE_SET.solve_batch(batch), ACTIVE_SET.solve_batch(list(batch))):  # type: ignore[attr-defined]
            np.testing.assert_allclose(answers.value, [each.value for each in alone], atol=1e-9)
    assert batch[1].metric is batch.metric is batch.copied()[2].metric is batch[1:][0].metric
    np.testing.assert_array_equal(ProblemBatch(g, J, metric=np.ones(4))[2].metric, np.ones(4))
    with pytest.raises(ValueError, match="problems should all have one and the same function as metric"):
        ProblemBatch.stack([DirectionProblem(g[0], J[0], metric=Products(M)) for _ in range(2)])


def test_a_step_whose_metric_is_not_reached_is_skipped_or_raises() -> None:
    rng = np.random.default_rng(7)
    M = np.diag(10.0 ** np.linspace(-3, 3, 40))
    linearization = Linearization([0.0, -1.0], rng.standard_normal((2, 40)))
    step = ConstrainedStep(metric=Products(M), metric_iterations=3)
    result = step(linearization, [0.0])
    assert result.counts["skipped"] == 1
    np.testing.assert_array_equal(result.change, np.zeros(40))
    with pytest.raises(DirectionError, match="metric_iterations"):
        ConstrainedStep(metric=Products(M), metric_iterations=3, on_failure="raise")(linearization, [0.0])


def test_what_leaves_float64_is_certified_by_nobody() -> None:
    """The square of a row of 1e-170 is no number any more."""
    problem = DirectionProblem([1.0, 0.0], [[1e-170, 0.0]], -1.0, metric=Products(np.eye(2)))
    wrong = Direction(np.array([0.0, 0.0]), np.array([-1e170]), Status.OPTIMAL)
    assert kkt_residuals(problem, wrong).worst == np.inf
    assert ACTIVE_SET.solve(problem).status == Status.NUMERICAL_ERROR
    assert farkas_residual(problem, np.ones(1)) == np.inf
