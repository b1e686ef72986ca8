"""Long problems in a ball, and in a diagonal metric: the answers and certificates of short ones, in coordinates."""

from typing import Any

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.solvers import is_installed
from cpgrl_opt.vectors import is_long

ACTIVE_SET = SOLVERS["active-set"]
N = 30_000


def small_problem(seed: int, m: int = 3) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    g, J = rng.standard_normal(8), rng.standard_normal((m, 8))
    if seed % 4 == 1:
        J[1] = -J[0]
    if seed % 4 == 2:
        g = -J.T @ rng.random(m)
    return {"gradient": g, "jacobian": J, "bound": 0.3 * rng.standard_normal(m) * (seed % 3 > 0)}


def spread(arguments: dict[str, Any], rng: np.random.Generator) -> tuple[dict[str, Any], np.ndarray]:
    """The same problem in 8 orthonormal vectors of N parameters."""
    basis = np.linalg.qr(rng.standard_normal((N, 8)))[0].T
    return {**arguments, "gradient": arguments["gradient"] @ basis, "jacobian": arguments["jacobian"] @ basis}, basis


@pytest.mark.parametrize("radius", [1e-3, 0.5, 1e12])
@pytest.mark.parametrize("seed", range(8))
def test_a_ball_in_many_parameters_is_that_in_few(seed: int, radius: float) -> None:
    few = small_problem(seed)
    many, basis = spread(few, np.random.default_rng(seed))
    assert is_long(3, N)
    expected = ACTIVE_SET.solve(DirectionProblem(**few, radius=radius))
    problem = DirectionProblem(**many, radius=radius)
    answer = ACTIVE_SET.solve(problem)
    assert answer.status == expected.status
    np.testing.assert_allclose(answer.value, expected.value @ basis, atol=1e-9 * max(np.linalg.norm(expected.value), 1))
    if answer.status == Status.OPTIMAL:
        assert kkt_residuals(problem, answer).worst <= 1e-9
        assert answer.residuals is not None
        assert answer.radius_multiplier == pytest.approx(expected.radius_multiplier, rel=1e-7, abs=1e-12)


def test_the_usual_one_is_solved_in_coordinates() -> None:
    many, _ = spread(small_problem(3), np.random.default_rng(0))
    assert ACTIVE_SET.solve(DirectionProblem(**many, radius=0.5)).rung == "gramian"


@pytest.mark.parametrize("name", [name for name, solver in SOLVERS.items() if is_installed(solver)])
def test_every_solver_takes_them(name: str) -> None:
    many, _ = spread({**small_problem(3), "bound": np.zeros(3), "equality": True}, np.random.default_rng(1))
    problem = DirectionProblem(**many, radius=0.5)
    answer = SOLVERS[name].solve(problem)
    assert answer.status == Status.OPTIMAL
    np.testing.assert_allclose(answer.value, ACTIVE_SET.solve(problem).value, atol=1e-6)


@pytest.mark.parametrize("kappa", [0.0, 0.4, -0.2])
def test_the_referee_sees_in_passes_what_it_sees_in_few_parameters(kappa: float) -> None:
    few = small_problem(5)
    many, basis = spread(few, np.random.default_rng(2))
    rng = np.random.default_rng(3)
    d, mu = rng.standard_normal(8), rng.standard_normal(3)
    expected, found = (
        kkt_residuals(DirectionProblem(**each, radius=0.7), Direction(value, mu, Status.OPTIMAL, 0, kappa))
        for each, value in ((few, d), (many, d @ basis))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("radius", [None, 0.5])
def test_a_diagonal_metric_is_units_of_the_parameters(radius: float | None) -> None:
    many, _ = spread(small_problem(6), np.random.default_rng(4))
    sizes = np.random.default_rng(5).uniform(0.5, 2.0, N)
    plain = ACTIVE_SET.solve(DirectionProblem(**many, radius=radius))
    scaled = {**many, "gradient": many["gradient"] * sizes, "jacobian": many["jacobian"] * sizes}
    problem = DirectionProblem(**scaled, metric=sizes**2, radius=radius)
    answer = ACTIVE_SET.solve(problem)
    assert answer.status == plain.status == Status.OPTIMAL
    np.testing.assert_allclose(answer.value * sizes, plain.value, atol=1e-10)
    assert kkt_residuals(problem, answer).worst <= 1e-9
