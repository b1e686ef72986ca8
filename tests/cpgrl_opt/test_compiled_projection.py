"""The compiled projection: exact rationals on hostile families, proofs on infeasible ones."""

from collections.abc import Callable

import numpy as np
import pytest

from cpgrl_opt import DirectionProblem, Status, farkas_residual, kkt_residuals
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.exact import exact_answer, is_small_enough
from cpgrl_opt.solvers.exact_core import project

TOLERANCE = 1e-12  # of the optimality residuals; what the method promises
PLAIN = [name for name, family in FAMILIES.items() if not {"metric", "ball"} & set(name.split("-"))]
UNDECIDED = ("opposing-1e-12", "parallel-1e-12")  # where a rounding of b moves d by much


def solved(problem: DirectionProblem):
    return project(problem, TOLERANCE, tangent=False)


def require_least_violation(problem: DirectionProblem, answer) -> None:
    """Ĵᵀr = 0 for r = (b̂ − Ĵd)₊, the gradient of ½‖r‖²; and multipliers that prove it."""
    assert answer.status == Status.INFEASIBLE, answer
    assert farkas_residual(problem, answer.multipliers) <= 1e-6
    length = np.linalg.norm(problem.jacobian, axis=1)
    length[length == 0.0] = 1.0
    lack = (problem.bound - problem.jacobian @ answer.value) / length
    lack = np.where(problem.equality, lack, np.maximum(lack, 0.0))
    rest = (problem.jacobian / length[:, None]).T @ lack
    assert np.linalg.norm(rest) <= 1e-12 * max(1.0, np.linalg.norm(answer.value))


@pytest.mark.parametrize("name", [name for name in PLAIN if name not in UNDECIDED])
def test_families_are_answered_as_exact_rationals_do(name: str) -> None:
    for number in range(1 if FAMILIES[name].is_large else 8):
        problem = FAMILIES[name].problem(number, 7)
        answer = solved(problem)
        if not FAMILIES[name].feasible:
            require_least_violation(problem, answer)
            continue
        assert answer.status == Status.OPTIMAL, answer
        assert kkt_residuals(problem, answer).worst <= TOLERANCE
        if is_small_enough(problem):
            exact = exact_answer(problem).direction
            size = max(float(np.linalg.norm(problem.gradient)), float(np.linalg.norm(exact)))
            assert np.linalg.norm(answer.value - exact) <= 1e-13 * size


Data = tuple[np.ndarray, np.ndarray, np.ndarray]


def at_an_angle(rng: np.random.Generator) -> Data:
    """Two rows 1e-9 rad from opposing, and two more, of any length."""
    rotation = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    J = np.vstack([[1, 0, 0, 0, 0], [-np.cos(1e-9), np.sin(1e-9), 0, 0, 0], rng.normal(size=(2, 5))]) @ rotation
    return rng.normal(size=5), J * rng.choice([1.0, 3.7, 0.2], size=(4, 1)), np.zeros(4)


def far_slack(rng: np.random.Generator) -> Data:
    J = rng.normal(size=(5, 6))
    near = J @ rng.normal(size=6) - np.abs(rng.normal(size=5))
    return rng.normal(size=6), J, np.where(rng.random(5) < 0.4, -(10.0 ** rng.uniform(3, 300, size=5)), near)


@pytest.mark.parametrize("exponent", [0, 170, -170])
@pytest.mark.parametrize("draw", [at_an_angle, far_slack], ids=lambda f: f.__name__)
def test_problems_at_the_limits_are_solved_to_the_referees_satisfaction(
    draw: Callable[[np.random.Generator], Data], exponent: int
) -> None:
    """g and J both of any scale, which leaves d and b as they are but for that of g."""
    scale = 10.0**exponent
    for seed in range(12):
        g, J, b = draw(np.random.default_rng(seed))
        problem = DirectionProblem(scale * g, J * scale, b if exponent == 0 else 0.0 * b)
        answer = solved(problem)
        assert answer.status == Status.OPTIMAL, answer
        assert kkt_residuals(problem, answer).worst <= TOLERANCE, answer


def walled_in(rng: np.random.Generator) -> Data:
    """Two rows 1e-8 from opposing leave room only beyond 1e8, and a third row closes it."""
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    J = np.array([[1, 0, 0], [-np.cos(1e-8), np.sin(1e-8), 0], [0, -1, 0]]) @ rotation
    return rng.normal(size=3), J, np.array([0.5 + rng.random(), 0.5 + rng.random(), -10.0])


def opposing(rng: np.random.Generator) -> Data:
    """Miss each other by 2e-9 of their lengths; another row beside them."""
    J = rng.normal(size=(3, 5))
    J[1] = -3.0 * J[0]
    b = J @ rng.normal(size=5) - [0.0, 0.0, 1.0]
    b[1] = -3.0 * b[0] + 6.0 * 2e-9 * max(1.0, np.abs(b).max()) * np.linalg.norm(J[0])
    return rng.normal(size=5), J, b


@pytest.mark.parametrize("draw", [walled_in, opposing], ids=lambda f: f.__name__)
def test_infeasible_problems_come_with_proof_and_the_least_violation(draw: Callable) -> None:
    for seed in range(12):
        problem = DirectionProblem(*draw(np.random.default_rng(seed)))
        answer = solved(problem)
        require_least_violation(problem, answer)
        lack = np.maximum(problem.bound - problem.jacobian @ answer.value, 0.0)
        nearest = solved(DirectionProblem(problem.gradient, problem.jacobian, problem.bound - lack - 1e-9))
        if draw is not walled_in:  # of the least violating directions the nearest to g is returned
            size = max(1.0, float(np.linalg.norm(problem.gradient)))
            assert np.linalg.norm(answer.value - nearest.value) <= 1e-6 * size


def test_a_zero_row_that_asks_for_something_is_the_proof() -> None:
    answer = solved(DirectionProblem([-1.0, 0.0], [[1.0, 2.0], [0.0, 0.0]], [0.0, 1e-9]))
    assert answer.status == Status.INFEASIBLE
    np.testing.assert_array_equal(answer.multipliers, [0.0, 1.0])
    np.testing.assert_allclose(answer.value, [-0.8, 0.4])  # the projection under the rows that ask for the possible
