"""Whether constraints contradict each other depends on (J, b) alone: not on g, nor on an unrelated, large bound."""

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, ConstrainedStep, DirectionProblem, Linearization, Status, farkas_residual
from cpgrl_opt.solvers import is_usable

NAMES = [name for name in ("active-set", "nnls", "enumeration", "quadprog", "clarabel") if is_usable(SOLVERS[name])]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("strength", [0.0, 4e9, 9e9, 1e10, 1e12, 1e16])
def test_a_row_that_asks_for_nothing_is_missed_too(name: str, strength: float) -> None:
    """D ≤ 0 and d ≥ 1: the row with b = 0 is missed by 1, which is little beside a long g."""
    along = DirectionProblem([-strength], [[-1.0], [1.0]], [0.0, 1.0])
    beside = DirectionProblem([0.0, strength], [[-1.0, 0.0], [1.0, 0.0]], [0.0, 1.0])
    for problem in (along, beside):
        answer = SOLVERS[name].solve(problem)
        assert answer.status == Status.INFEASIBLE
        assert farkas_residual(problem, answer.multipliers) <= 1e-9


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("other", [1e6, 1e10, 1e11, 1e12, 1e13, 1e14, 1e16])
def test_an_unrelated_bound_hides_no_contradiction(name: str, other: float) -> None:
    at_45_degrees = DirectionProblem(np.zeros(3), [[1, 0, 0], [-1, -1, 0], [0, 1, 0], [0, 0, 1]], [1, 1, 0, other])
    opposing = DirectionProblem(np.zeros(2), [[1, 0], [-1, 0], [0, 1]], [1, 1, other])
    for problem in (at_45_degrees, opposing):
        assert SOLVERS[name].solve(problem).status == Status.INFEASIBLE


@pytest.mark.parametrize("seed", range(30))
def test_contradictory_integers_stay_so_whatever_stands_beside_them(seed: int) -> None:
    """J and b of small integers with Jᵀy = 0, bᵀy > 0, y > 0; and a gradient or a bound in a direction of its own."""
    rng = np.random.default_rng(seed)
    m, n = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    y, J = rng.integers(1, 4, m).astype(float), np.zeros((m, n + 1))
    J[:-1, :n] = rng.integers(-3, 4, (m - 1, n))
    J[-1, :n] = -(y[:-1] @ J[:-1, :n])
    J[:-1, :n] *= y[-1]
    b = np.zeros(m)
    b[int(rng.integers(m))] = 1.0
    g = np.zeros(n + 1)
    for far in (1.0, 1e9, 1e12, 1e15):
        g[n] = far
        assert SOLVERS["active-set"].solve(DirectionProblem(g, J, b)).status == Status.INFEASIBLE
        rows = np.vstack([J, np.eye(n + 1)[n]])
        beside = DirectionProblem(np.zeros(n + 1), rows, np.append(b, far))
        assert SOLVERS["active-set"].solve(beside).status == Status.INFEASIBLE


@pytest.mark.parametrize("seed", range(20))
def test_what_can_be_met_is_met_beside_long_gradients_and_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, n = rng.integers(1, 6, 2)
    J = rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-3, 3, (m, 1))
    at = J @ rng.normal(size=n) * 10.0 ** rng.uniform(-3, 3)
    bound = at - np.abs(at) * rng.integers(0, 2, m)
    problem = DirectionProblem(rng.normal(size=n) * 10.0 ** rng.uniform(-2, 12), J, bound)
    assert SOLVERS["active-set"].solve(problem).status == Status.OPTIMAL


@pytest.mark.parametrize("climb", [1.0, 100.0, 1e4, 1e8])
@pytest.mark.parametrize("slack", [-1e-8, -1e-6])
def test_a_step_says_so_too_however_steep_the_objective(climb: float, slack: float) -> None:
    linearization = Linearization([0.0, 0.0, slack], [[0.0, climb, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    result = ConstrainedStep(formulation="restoring")(linearization, [0.0, 0.0])
    assert result.counts["infeasible"] == 1
    assert result.change[0] == pytest.approx(0.01 * slack, rel=1e-6)
