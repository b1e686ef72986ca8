"""The exact search in a ball: by hand, and as the judge of solvers that know nothing of it."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import ModuleType

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status
from cpgrl_opt.exact.trust_region import TrustRegionAnswer, exact_trust_region, shortest_length
from cpgrl_opt.solvers import is_usable, supports
from cpgrl_opt.testing.law import vary

JUDGED = [name for name in ("active-set", "nnls", "daqp", "clarabel") if is_usable(SOLVERS[name])]
EACH = 1  # problems of a family; thousands by `python benchmarks/trust_regions.py`


@pytest.fixture(scope="session")
def benchmark(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("trust_regions")


def test_the_length_comes_from_the_ball_and_kappa_from_the_climb() -> None:
    # g = (3, 4) in a ball of 2: (1.2, 1.6), κ = 5/2. A wall d₁ ≥ 1 is met, and d₂ ≤ 1 holds it at (√3, 1).
    free = exact_trust_region(DirectionProblem([3.0, 4.0], [[1.0, 0.0]], [1.0], radius=2.0))
    np.testing.assert_allclose(free.direction, [1.2, 1.6], rtol=1e-16)
    assert (free.radius_multiplier, free.multipliers.tolist(), free.margin) == (2.5, [0.0], 0.75)
    held = exact_trust_region(DirectionProblem([3.0, 4.0], [[0.0, -1.0]], [-1.0], radius=2.0))
    np.testing.assert_array_equal(held.direction, [np.sqrt(3.0), 1.0])
    assert held.radius_multiplier == np.sqrt(3.0)  # κ(√3, 1) = (3, 4 − μ)
    np.testing.assert_allclose(held.multipliers, [4.0 - np.sqrt(3.0)], rtol=1e-15)
    assert held.face.tolist() == [True]


def test_a_metric_measures_the_ball() -> None:
    # 4d₁² + d₂² ≤ 4 and g = (2, 0): (1, 0), κ·4·1 = 2.
    answer = exact_trust_region(DirectionProblem([2.0, 0.0], np.zeros((0, 2)), metric=[4.0, 1.0], radius=2.0))
    assert (answer.direction.tolist(), answer.radius_multiplier) == ([1.0, 0.0], 0.5)


def test_of_many_optima_the_shortest() -> None:
    answer = exact_trust_region(DirectionProblem([2.0, 0.0], [[-1.0, 0.0], [1.0, 1.0]], [-1.0, 2.0], radius=50.0))
    assert (answer.direction.tolist(), answer.radius_multiplier) == ([1.0, 1.0], 0.0)
    nothing = exact_trust_region(DirectionProblem([0.0, 0.0], [[1.0, 1.0]], [1.0], metric=[1.0, 4.0], radius=2.0))
    np.testing.assert_allclose(nothing.direction, [0.8, 0.2], rtol=1e-16)


def test_a_ball_that_only_touches_leaves_one_point_and_no_multipliers() -> None:
    touching = DirectionProblem([0.0, 1.0], [[3.0, 4.0]], [25.0], radius=5.0)
    answer = exact_trust_region(touching)
    assert (answer.feasible, answer.direction.tolist(), answer.multipliers) == (True, [3.0, 4.0], None)
    assert not exact_trust_region(vary(touching, radius=np.nextafter(5.0, 0.0))).feasible
    assert exact_trust_region(vary(touching, radius=np.nextafter(5.0, 6.0))).multipliers is not None


def test_a_vertex_on_the_sphere_has_many_kappas() -> None:
    corner = DirectionProblem([1.0, 1.0], [[-1.0, 0.0], [0.0, -1.0]], [-3.0, -4.0], radius=5.0)
    answer = exact_trust_region(corner)
    assert (answer.direction.tolist(), answer.radius_multiplier) == ([3.0, 4.0], None)


def test_a_ball_that_misses_holds_back_the_least_violation() -> None:
    # d₁ ≥ 2 and 3d₂ ≥ 6 from the unit ball: on unit rows both are missed alike, at the diagonal.
    answer = exact_trust_region(DirectionProblem([1.0, 0.0], [[1.0, 0.0], [0.0, 3.0]], [2.0, 6.0], radius=1.0))
    assert not answer.feasible
    np.testing.assert_allclose(answer.direction, np.full(2, np.sqrt(0.5)), rtol=1e-15)
    assert answer.radius_multiplier == pytest.approx(2 * np.sqrt(2.0) - 1, rel=1e-15)  # b̂ − d = λd


def test_contradicting_rows_climb_as_far_as_the_ball_lets_them() -> None:
    answer = exact_trust_region(DirectionProblem([1.0, 2.0], [[1.0, 0.0], [-2.0, 0.0]], [0.5, 1.0], radius=1.0))
    assert (answer.feasible, answer.direction.tolist()) == (False, [0.0, 1.0])
    assert answer.multipliers.tolist() == [0.5, 0.25]


def test_a_zero_row_that_asks_is_impossible_and_moves_nothing() -> None:
    answer = exact_trust_region(DirectionProblem([3.0, 4.0], [[0.0, 0.0], [1.0, 0.0]], [1.0, 0.0], radius=10.0))
    assert (answer.feasible, answer.direction.tolist(), answer.multipliers.tolist()) == (False, [6.0, 8.0], [1.0, 0.0])
    for bound, equality in ((-1.0, False), (0.0, True)):  # what asks for nothing is met
        assert exact_trust_region(DirectionProblem([3.0, 4.0], [[0.0, 0.0]], bound, equality, radius=10.0)).feasible


def test_the_shortest_direction_has_a_length() -> None:
    assert shortest_length(DirectionProblem([7.0, 0.0], [[3.0, 4.0]], [25.0])) == 5.0
    assert shortest_length(DirectionProblem([7.0], [[1.0], [-1.0]], [1.0, 0.0])) is None


@cache
def drawn(benchmark: ModuleType, family: str) -> list[tuple[DirectionProblem, TrustRegionAnswer]]:
    problems = [benchmark.problem_of(family, number, 0) for number in range(EACH)]
    return [(problem, exact_trust_region(problem)) for problem in problems]


@pytest.mark.parametrize("name", JUDGED)
def test_solvers_agree_with_the_exact_search(benchmark: ModuleType, name: str) -> None:
    solver, declined, asked = SOLVERS[name], [], 0
    error = benchmark.ERRORS * benchmark.EPS if name in benchmark.EXACT else solver.tolerance
    for family in benchmark.FAMILIES:
        for problem, exact in drawn(benchmark, family):
            if not supports(solver, problem):
                continue
            answer, asked = solver.solve(problem), asked + 1
            told = benchmark.complaint(problem, exact, answer, solver.tolerance, error)
            if told and answer.status not in benchmark.CLAIMS:
                declined.append(family)
                continue
            assert not told, f"{family}: {told}: {benchmark.state(problem)}"
    assert asked > 25
    assert len(declined) <= (0 if name in benchmark.EXACT else 0.05 * asked), declined


WRONG: dict[str, Callable[[Direction], Direction]] = {
    "‖d − d\\*‖": lambda right: replace(right, value=right.value * (1 + 1e-13)),
    "κ =": lambda right: replace(right, radius_multiplier=right.radius_multiplier * (1 + 1e-10)),
    "residual": lambda right: replace(right, multipliers=right.multipliers + 1e-6),
    "INFEASIBLE for OPTIMAL": lambda right: replace(right, status=Status.INFEASIBLE),
    "UNCERTIFIED for OPTIMAL": lambda right: replace(right, status=Status.UNCERTIFIED),
}


@pytest.mark.parametrize("told", WRONG)
def test_the_judge_sees_what_is_wrong(benchmark: ModuleType, told: str) -> None:
    problem = DirectionProblem([3.0, 4.0], [[0.0, -1.0]], [-1.0], radius=2.0)
    exact = exact_trust_region(problem)
    assert exact.radius_multiplier is not None
    right = Direction(exact.direction, exact.multipliers, Status.OPTIMAL, 0, exact.radius_multiplier)
    judged = (problem, exact), (1e-9, benchmark.ERRORS * benchmark.EPS)
    assert benchmark.complaint(*judged[0], right, *judged[1]) == ""
    assert re.search(told, benchmark.complaint(*judged[0], WRONG[told](right), *judged[1]))


def test_the_judge_wants_a_proof(benchmark: ModuleType) -> None:
    problem = DirectionProblem([1.0, 0.0], [[1.0, 0.0], [0.0, 3.0]], [2.0, 6.0], radius=1.0)
    exact = exact_trust_region(problem)
    right = Direction(exact.direction, exact.multipliers, Status.INFEASIBLE)
    assert benchmark.complaint(problem, exact, right, 1e-9, 1e-14) == ""
    for y in ([0.0, 0.0], [1.0, -1e-9], [-1.0, 1.0]):
        claimed = replace(right, multipliers=np.array(y))
        assert benchmark.complaint(problem, exact, claimed, 1e-9, 1e-14) == "the multipliers prove nothing"


def test_a_solver_that_is_wrong_is_shown_the_smallest_problem(benchmark: ModuleType, monkeypatch) -> None:
    class Short:
        tolerance, takes_geometry = 1e-9, True

        def solve(self, problem: DirectionProblem) -> Direction:
            right = SOLVERS["active-set"].solve(problem)
            return replace(right, value=0.5 * right.value)

    monkeypatch.setitem(benchmark.__dict__, "SOLVERS", {"active-set": Short()})
    row = benchmark.examine("active-set", "out of reach", 5, 0)
    assert row.agreed < row.taken == 5
    assert "radius, for at most" in row.complaint
    assert isinstance(eval(row.problem, {"DirectionProblem": DirectionProblem}), DirectionProblem)
