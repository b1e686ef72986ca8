"""A huge radius decides as none would, a neighbour in the batch nothing, and what contradicts itself is infeasible."""

from typing import ClassVar

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem, ProblemBatch, Status
from cpgrl_opt.solvers import NNLS, is_installed
from cpgrl_opt.solvers.small_problem import SmallAnswer, SmallProblem

ACTIVE_SET = SOLVERS["active-set"]


@pytest.mark.parametrize("radius", [1e6, 1e12, 1e15])
def test_what_can_be_met_can_be_met_in_a_huge_ball(radius: float) -> None:
    """The shortest of what climbs most, where the rows end the climb: as without a ball and g as long as it gets."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        J, b = rng.integers(-3, 4, (6, 3)).astype(float), -rng.integers(0, 4, 6).astype(float)
        g = -J.T @ rng.integers(0, 3, 6)
        answer = ACTIVE_SET.solve(DirectionProblem(g, J, b, radius=radius))
        assert answer.status == Status.OPTIMAL
        assert np.linalg.norm(answer.value) < radius  # g is in the rows' cone: no end of the climb but theirs
        far = ACTIVE_SET.solve(DirectionProblem(1e4 * g, J, b))
        np.testing.assert_allclose(answer.value, far.value, atol=1e-9)


def hostile_neighbours(n: int, m: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """g and J of runs beside which the others are solved."""
    big, small, opposing = np.full((m, n), 1e170), np.full((m, n), 1e-170), np.ones((m, n))
    opposing[1::2] *= -1.0
    return [(np.ones(n), each) for each in (big, small, opposing, np.zeros((m, n)))] + [(np.zeros(n), np.ones((m, n)))]


@pytest.mark.parametrize("metric", [False, True])
@pytest.mark.parametrize("name", ["active-set", "rosen"])
def test_a_run_has_the_same_bits_whatever_stands_beside_it(name: str, metric: bool) -> None:
    rng, solver, n, m = np.random.default_rng(1), SOLVERS[name], 5, 3
    M = rng.uniform(0.5, 2.0, n) if metric else None
    for k in range(6):
        g, J, b = rng.standard_normal(n), rng.standard_normal((m, n)), 0.2 * rng.standard_normal(m)
        alone = solver.solve(DirectionProblem(g, J, b, name == "rosen", M, 0.7))
        for other_g, other_J in hostile_neighbours(n, m):
            order = [(g, J), (other_g, other_J)][:: 1 if k % 2 else -1]
            batch = ProblemBatch(
                [each for each, _ in order],
                [each for _, each in order],
                [b, b],
                np.full((2, m), name == "rosen"),
                None if M is None else np.stack([M, M]),
                [0.7, 0.7],
            )
            beside = solver.solve_batch(batch)[0 if k % 2 else 1]  # type: ignore[attr-defined]
            np.testing.assert_array_equal(beside.value, alone.value)
            np.testing.assert_array_equal(beside.multipliers, alone.multipliers)
            assert (beside.status, beside.radius_multiplier) == (alone.status, alone.radius_multiplier)


@pytest.mark.parametrize("angle", [1e-6, 1e-8, 1e-9])
@pytest.mark.parametrize("name", ["active-set", "nnls", "osqp", "clarabel"])
def test_rows_that_nearly_oppose_each_other_are_as_exact_in_a_ball_as_without(name: str, angle: float) -> None:
    if not is_installed(SOLVERS[name]):
        pytest.skip(f"{name} is not installed")
    for seed in range(10):
        rng = np.random.default_rng(seed)
        A = rng.standard_normal((2, 6))
        g, J = rng.standard_normal(6) - 3 * A[1], np.vstack([A[0], -A[0] + angle * A[1]])
        answer = SOLVERS[name].solve(DirectionProblem(g, J, radius=0.5))
        plain = ACTIVE_SET.solve(DirectionProblem(g, J)).value
        assert answer.status == Status.OPTIMAL
        assert answer.residuals is not None
        assert answer.residuals.worst <= 1e-12
        np.testing.assert_allclose(answer.value, 0.5 * plain / np.linalg.norm(plain), atol=1e-12)


@pytest.mark.parametrize("angle", [1e-6, 1e-9, 1e-10, 1e-11])
@pytest.mark.parametrize("asked", [1e-6, 1e-3, 0.1])
def test_rows_that_are_met_far_beyond_the_ball_are_out_of_reach(angle: float, asked: float) -> None:
    """Met only at 2b/θ: the ball's multiplier in the least violation is about bθ, which no fixed weight is below."""
    rows = [[1.0, 0.0], [-np.cos(angle), np.sin(angle)]]
    radius = asked / angle / 100
    found = ACTIVE_SET.solve(DirectionProblem([1.0, 1.0], rows, [asked, asked], radius=radius))
    assert found.status == Status.INFEASIBLE
    assert found.value @ found.value <= (1 + 1e-9) * radius**2


class Counting(NNLS):
    """With how often it was asked."""

    asked: ClassVar[list[int]] = []

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        self.asked.append(len(small.bound))
        return super().solve_small(small)


def test_the_search_for_kappa_asks_its_core_twice_a_problem() -> None:
    """Where it looks next is 1/κ of the face that the last answer named; halving a bracket takes a fifth longer."""
    Counting.asked.clear()
    for seed in range(60):
        rng = np.random.default_rng(seed)
        g, J, b = 10.0 * rng.standard_normal(6), rng.standard_normal((12, 6)), -0.5 * np.abs(rng.standard_normal(12))
        assert Counting().solve(DirectionProblem(g, J, b, radius=1.0)).status == Status.OPTIMAL
    assert len(Counting.asked) <= 2 * 60
