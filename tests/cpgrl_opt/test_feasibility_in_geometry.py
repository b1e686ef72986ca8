"""Whether constraints contradict each other depends neither on g, nor on a metric, nor on a ball."""

import numpy as np
import pytest

from cpgrl_opt import (
    SOLVERS,
    ConstrainedStep,
    Direction,
    DirectionError,
    DirectionProblem,
    Linearization,
    Status,
    WithGeometry,
    solve,
)
from cpgrl_opt.certify import farkas_residual
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


# Rows 1e-3 rad from opposing, and one that asks for 1 across them. A violation of 1e-3 is 1e-10 of lengths in M.
WEDGE, ACROSS, STRETCH = [[1.0, 0.0], [-1.0, -1e-3], [0.0, 1.0]], [0.0, 0.0, 1.0], np.array([1.0, 1e14])
STRETCHES = {"diagonal": STRETCH, "full": np.diag(STRETCH), "function": STRETCH.__mul__}


@pytest.mark.parametrize("radius", [None, 1e6, 1e8, 1e12, 1e20])
@pytest.mark.parametrize("metric", STRETCHES)
@pytest.mark.parametrize("name", ["active-set", "nnls", "quadprog"])
def test_a_metric_hides_no_contradiction_whatever_the_ball(name: str, metric: str, radius: float | None) -> None:
    if not is_usable(SOLVERS[name]):
        pytest.skip(f"{name} is not installed")
    problem = DirectionProblem([0.3, 0.2], WEDGE, ACROSS, metric=STRETCHES[metric], radius=radius)
    answer = SOLVERS[name].solve(problem)
    assert answer.status == Status.INFEASIBLE
    assert farkas_residual(problem, answer.multipliers) <= 1e-5
    if metric != "function":  # in whose coordinates the first two rows depend
        met = SOLVERS[name].solve(DirectionProblem([0.3, 0.2], WEDGE, [0.0, -1e-3, 0.5], metric=STRETCHES[metric]))
        assert met.status == Status.OPTIMAL


@pytest.mark.parametrize("formulation", ["cone", "restoring", "linearized"])
@pytest.mark.parametrize(
    ("n", "metric"), [(2, "diagonal"), (2, "full"), (2, "function"), (30_000, "diagonal"), (30_000, "function")]
)
def test_nor_does_it_in_a_step(formulation: str, metric: str, n: int) -> None:
    gradients = np.zeros((2, 4, n))
    gradients[:, 1:, :2] = WEDGE
    M = np.append(STRETCH, np.ones(n - 2))
    given = np.diag(M) if metric == "full" else M if metric == "diagonal" else M.__mul__
    step = ConstrainedStep(formulation=formulation, metric=given, step_size=1.0, restoration_rate=1.0)
    result = step(Linearization([[0.0, 0.0, 0.0, -1.0], [0.0, 0.0, 0.0, 0.0]], gradients), np.zeros(3))
    assert result.counts["infeasible"].tolist() == [1, 0]
    assert np.isnan(result.residuals).all(axis=1).tolist() == [True, False]  # an optimum in M alone is none
    assert formulation == "cone" or not result.stationary[0]


@pytest.mark.parametrize("seed", range(40))
def test_whether_integers_contradict_each_other_no_metric_and_no_ball_changes(seed: int) -> None:
    """Rows that sum up to 0, and bounds that sum up to one side of it; lengths in M up to 1e6 times the rows'."""
    rng = np.random.default_rng(seed)
    J = rng.integers(-3, 4, size=(4, 3)).astype(float)
    J[3] = -J[:3].sum(axis=0)
    inside = rng.integers(-2, 3, size=3)
    bound = J @ inside - rng.integers(0, 2, size=4)
    if seed % 2:  # a sum above 0
        bound[rng.integers(4)] += 1.0 - min(0.0, bound.sum())
    M = 10.0 ** rng.integers(0, 13, size=3)
    for metric in (M, np.diag(M)):
        for radius in (None, 1e9, 1e15):
            answer = solve(DirectionProblem(rng.normal(size=3), J, bound, metric=metric, radius=radius))
            assert answer.status == (Status.INFEASIBLE if seed % 2 else Status.OPTIMAL), (J, bound, M, radius)


PLANE = np.array([[2.0, 1.0], [1.0, 2.0]])


@pytest.mark.parametrize(("tilt", "tolerance"), [(1e-6, 1e-12), (1e-3, 1e-8), (0.1, 1e-3)])
@pytest.mark.parametrize("radius", [None, 1e3])
def test_what_is_rounded_in_a_metrics_coordinates_is_no_contradiction(
    tilt: float, tolerance: float, radius: float | None
) -> None:
    rows, bound = [[-tilt, -1.0], [0.0, 1.0]], [1.0, -1.0]  # met by (0, -1)
    problem = DirectionProblem(
        [0.0, 0.0], rows, bound, metric=PLANE.__matmul__, metric_tolerance=tolerance, radius=radius
    )
    answer = solve(problem)
    assert answer.status in (Status.OPTIMAL, Status.UNCERTIFIED)
    if radius is None:
        assert farkas_residual(problem, np.ones(2)) >= tilt / 10


@pytest.mark.parametrize("tilt", [1e-6, 1e-7])
def test_what_is_met_far_away_is_no_contradiction_where_the_metric_is_a_function(tilt: float) -> None:
    """By (−1/tilt, −1), a million times the bounds away: a proof to √tolerance would say that nothing meets it."""
    problem = DirectionProblem([0.0, 0.0], [[-tilt, -1.0], [0.0, 1.0]], [2.0, -1.0], metric=PLANE.__matmul__)
    assert solve(problem).status == Status.UNCERTIFIED


def test_nor_is_it_in_a_step() -> None:
    given = Linearization([0.0, -1.0, 0.0], [[0.0, 0.0], [1e-6, -1.0], [0.0, 1.0]])
    settings = {"formulation": "restoring", "step_size": 1.0, "restoration_rate": 1.0, "metric": PLANE.__matmul__}
    result = ConstrainedStep(**settings)(given, [0.0, 0.0])
    assert (result.counts["infeasible"], result.counts["skipped"]) == (0, 1)
    with pytest.raises(DirectionError):
        ConstrainedStep(**settings, on_failure="raise")(given, [0.0, 0.0])


@pytest.mark.parametrize("radius", [None, 1e6, 1e10, 1e14, 1e20])
def test_a_huge_ball_hides_no_contradiction(radius: float | None) -> None:
    for rows, bound in (
        ([[-155.0, 48.5], [155.0, -48.5]], [0.001, 0.0]),
        ([[4.0, 4.0], [-4.0, -4.0], [-2.0, 1.0]], [-20.0, 20.03125, 10.0]),
    ):
        assert solve(DirectionProblem([0.3, 1.3], rows, bound, radius=radius)).status == Status.INFEASIBLE
