"""Whether constraints contradict each other depends neither on g, nor on a metric, nor on a ball."""

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status, WithGeometry
from cpgrl_opt.solvers import is_usable

UP_AND_DOWN = [[0.0, 1.0], [0.0, -1.0]]


@pytest.mark.parametrize("strength", [1.0, 1e8, 1e12])
@pytest.mark.parametrize("geometry", [{"metric": [1.0, 2.0]}, {"radius": 1e3}], ids=["metric", "radius"])
@pytest.mark.parametrize("name", ["active-set", "nnls", "cvxpy", "osqp"])
def test_contradicting_rows_are_never_met(name: str, geometry: dict[str, object], strength: float) -> None:
    if not is_usable(SOLVERS[name]):
        pytest.skip(f"{name} is not installed")
    answer = SOLVERS[name].solve(DirectionProblem([strength, 0.0], UP_AND_DOWN, 1.0, **geometry))  # type: ignore[arg-type]
    assert answer.status == Status.INFEASIBLE


class Liar:
    """Says OPTIMAL of what looks so beside a long gradient."""

    def solve(self, problem: DirectionProblem) -> Direction:
        return Direction(problem.gradient.copy(), np.zeros(problem.m), Status.OPTIMAL)


@pytest.mark.parametrize("strength", [1e10, 1e15])
def test_a_third_partys_claim_beside_a_long_gradient_does_not_stand(strength: float) -> None:
    problem = DirectionProblem([strength, 0.0], UP_AND_DOWN, 1.0, metric=[1.0, 2.0])
    assert WithGeometry(Liar()).solve(problem).status == Status.UNCERTIFIED
