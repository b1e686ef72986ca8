"""Whether constraints contradict each other depends on (J, b) alone: not on g, an unrelated bound, metric or ball."""

from collections.abc import Iterator

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
    farkas_residual,
    solve,
)
from cpgrl_opt.certify import certify
from cpgrl_opt.solvers import is_usable
from cpgrl_opt.solvers.infeasibility import infeasible_direction

from .steps import Claiming

UP_AND_DOWN = [[0.0, 1.0], [0.0, -1.0]]
# Seven rows that contradict each other, and ask for 2 at the most: once a RecursionError in a huge ball.
SEVEN = [
    *([0, 1, 0, -2, 1, -2], [-2, 0, 0, 0, 2, -1], [2, -1, 1, 1, -1, 0], [-1, 0, -2, 1, -2, -1], [0, -1, 0, 0, 0, 0]),
    *([-2, 1, -2, 1, 0, 2], [0, -1, 2, -2, -1, 1]),
]
# Rows 1e-3 rad from opposing, and one that asks for 1 across them. A violation of 1e-3 is 1e-10 of lengths in M.
WEDGE, ACROSS, STRETCH = [[1.0, 0.0], [-1.0, -1e-3], [0.0, 1.0]], [0.0, 0.0, 1.0], np.array([1.0, 1e14])
# Five rows of rank 4, whose violation is 1e-10 of lengths in a metric of condition 5e5: once UNCERTIFIED in a ball.
HIDDEN = (
    [-4, 0, -5, -2, -2],
    [[-1, -1, 1, 0, 0], [2, 2, -1, 1, 1], [3, 2, -1.5, -0.5, 0.5], [-1, 2, 0, -2, -2], [-2, 0, -1, 1, -1]],
    [-2.25, -18.5, 16.25, 12, -17],
)
HIDING = [
    *([44, 0.75, 192, 0, -160], [0.75, 0.0703125, 10, -0.03515625, 2], [192, 10, 2560, -2, 512]),
    *([0, -0.03515625, -2, 0.0390625, -2], [-160, 2, 512, -2, 2816]),
]
STRETCHES = {"diagonal": STRETCH, "full": np.diag(STRETCH), "function": STRETCH.__mul__}


def contradictions() -> Iterator[tuple[str, DirectionProblem]]:
    for strength in (0.0, 1.0, 1e6, 4e9, 9e9, 1e10, 1e12, 1e16):
        yield f"gradient {strength:g}", DirectionProblem([strength, 0.0], UP_AND_DOWN, 1.0)
        yield f"zero bound, along {strength:g}", DirectionProblem([-strength], [[-1.0], [1.0]], [0.0, 1.0])
        yield f"zero bound, across {strength:g}", DirectionProblem([0.0, strength], [[-1, 0], [1, 0]], [0.0, 1.0])
    for other in (1.0, 1e6, 1e9, 1e11, 1e13, 1e16):
        rows = [[1, 0, 0], [-1, -1, 0], [0, 1, 0], [0, 0, 1]]
        yield f"at 45 degrees, beside {other:g}", DirectionProblem(np.zeros(3), rows, [1, 1, 0, other])
        yield f"bound {other:g}", DirectionProblem([0.0, 0.0], [*UP_AND_DOWN, [1.0, 0.0]], [1.0, 1.0, other])
    for radius in (None, 1.0, 1e3, 1e6, 1e9, 1e12, 1e15, 1e20, 1e100):
        yield f"seven, radius {radius}", DirectionProblem(np.zeros(6), SEVEN, [0, 2, -1, -1, 2, 1, -1], radius=radius)
        yield (
            f"seven and a gradient, radius {radius}",
            DirectionProblem(np.arange(-2.0, 4.0), SEVEN, [0, 2, -1, -1, 2, 1, -1], radius=radius),
        )
        rows = [[4.0, 4.0], [-4.0, -4.0], [-2.0, 1.0]]
        yield f"three, radius {radius}", DirectionProblem([0.3, 1.3], rows, [-20.0, 20.03125, 10.0], radius=radius)
    for tilt in (0.0, 3.7e-17, 1e-15, 3e-14):  # only what is longer than 1e13 times the bounds would meet them
        for radius in (None, 10.0, 1e9):
            rows = [[1.0, 0.0], [-1.0, tilt]]
            yield f"tilt {tilt:g}, radius {radius}", DirectionProblem([0.3, 1.0], rows, 1.0, radius=radius)
    for strength in (1.0, 1e8, 1e12):
        for geometry in ({"metric": [1.0, 2.0]}, {"radius": 1e3}):
            yield f"{geometry}, {strength:g}", DirectionProblem([strength, 0.0], UP_AND_DOWN, 1.0, **geometry)
    for form, metric in STRETCHES.items():
        for radius in (None, 1e6, 7e6, 1e12, 1e20):  # least violation is at (−1e-3, 1), whose length in M is 1e7
            problem = DirectionProblem([0.3, 0.2], WEDGE, ACROSS, metric=metric, radius=radius)
            yield f"wedge, {form}, radius {radius}", problem
    for radius in (None, 1e3, 1e6, 1e12):
        yield f"hidden, radius {radius}", DirectionProblem(*HIDDEN, True, metric=HIDING, radius=radius)
    for metric in (None, [4.0, 1.0], [[4.0, 1.0], [1.0, 2.0]]):
        for equality, radius in ((False, 2.0), (True, 2.0), (False, 1e6)):
            problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0], [0.0, 0.0]], [0.1, 1.0], equality, metric, radius)
            yield f"zero row, metric {metric}, {equality}, radius {radius}", problem
    for size in (1.0, 1e-12, 1e8):
        rows = [[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]]
        yield f"unit {size:g}", DirectionProblem([1.0, 1.0], rows, 1.0, metric=size * np.array([1e-6, 1.0]))


def length(problem: DirectionProblem, d: np.ndarray) -> float:
    M = np.eye(problem.n) if problem.metric is None else problem.metric
    force = M(d) if callable(M) else M * d if np.ndim(M) == 1 else M @ d
    return float(np.sqrt(d @ force))


@pytest.mark.parametrize("name", ["active-set", "nnls", "quadprog", "enumeration", "clarabel"])
def test_contradictions_are_found_with_proof_whatever_stands_beside(name: str) -> None:
    if not is_usable(SOLVERS[name]):
        pytest.skip(f"{name} is not installed")
    for case, problem in list(contradictions())[:: 1 if name == "active-set" else 10]:
        answer = SOLVERS[name].solve(problem)
        assert answer.status == Status.INFEASIBLE, case
        assert farkas_residual(problem, answer.multipliers) <= 1e-5, case
        assert problem.radius is None or length(problem, answer.value) <= problem.radius * (1 + 1e-12), case
        assert answer.radius_multiplier == 0.0, case


@pytest.mark.parametrize("seed", range(24))
def test_integers_contradict_each_other_or_not_whatever_metric_ball_gradient_and_bound(seed: int) -> None:
    """Rows that sum up to 0, and bounds that sum up to one side of it; lengths in M up to 1e6 times the rows'."""
    rng = np.random.default_rng(seed)
    J = rng.integers(-3, 4, size=(4, 3)).astype(float)
    J[3] = -J[:3].sum(axis=0)
    bound = J @ rng.integers(-2, 3, size=3) - rng.integers(0, 2, size=4)
    if seed % 2:  # a sum above 0
        bound[rng.integers(4)] += 1.0 - min(0.0, bound.sum())
    M, right = 10.0 ** rng.integers(0, 13, size=3), Status.INFEASIBLE if seed % 2 else Status.OPTIMAL
    for metric in (None, M, np.diag(M)):
        for radius in (None, 1e9, 1e15):
            answer = solve(DirectionProblem(rng.normal(size=3), J, bound, metric=metric, radius=radius))
            assert answer.status == right, (J, bound, M, radius)
    wide = np.hstack([J, np.zeros((4, 1))])
    for far in (1e9, 1e12, 1e15):
        beside = DirectionProblem(np.zeros(4), np.vstack([wide, np.eye(4)[3]]), np.append(bound, far))
        for problem in (DirectionProblem([1.0, 0.0, 0.0, far], wide, bound), beside):
            assert solve(problem).status == right


@pytest.mark.parametrize("seed", range(20))
def test_what_can_be_met_is_met_beside_long_gradients_and_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, n = rng.integers(1, 6, 2)
    J = rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-3, 3, (m, 1))
    at = J @ rng.normal(size=n) * 10.0 ** rng.uniform(-3, 3)
    bound = at - np.abs(at) * rng.integers(0, 2, m)
    problem = DirectionProblem(rng.normal(size=n) * 10.0 ** rng.uniform(-2, 12), J, bound)
    assert solve(problem).status == Status.OPTIMAL
    for length in (1.0, 1e9, 1e16):
        assert solve(DirectionProblem([length, 0.0], UP_AND_DOWN, [1.0, -1.0])).status == Status.OPTIMAL  # d₂ = 1
    for metric in (STRETCH, np.diag(STRETCH)):
        met = solve(DirectionProblem([0.3, 0.2], WEDGE, [0.0, -1e-3, 0.5], metric=metric))
        assert met.status == Status.OPTIMAL


@pytest.mark.parametrize("strength", [1e10, 1e15])
def test_a_third_partys_claim_beside_a_long_gradient_or_in_a_stretched_metric_does_not_stand(strength: float) -> None:
    liar = Claiming(None, Status.OPTIMAL)  # OPTIMAL is what looks so beside a long gradient
    for metric in (None, [1.0, 2.0]):
        problem = DirectionProblem([strength, 0.0], UP_AND_DOWN, 1.0, metric=metric)
        assert WithGeometry(liar).solve(problem).status == Status.UNCERTIFIED
    feasible = DirectionProblem([strength, 0.0], UP_AND_DOWN, [-1.0, 1.0 - 2.0])
    assert solve(feasible, liar).status == Status.OPTIMAL
    for metric in STRETCHES.values():
        problem = DirectionProblem([0.0, 0.0], WEDGE, ACROSS, metric=metric)
        for mu in (np.zeros(3), np.array([0.0, 1e14, 1e11])):
            claim = Direction(np.array([-1e-3, 1.0]), mu, Status.OPTIMAL)
            assert certify(problem, claim, 1e-9, infeasible_direction).status == Status.UNCERTIFIED


@pytest.mark.parametrize("formulation", ["cone", "restoring", "linearized"])
@pytest.mark.parametrize(("n", "metric"), [(2, "diagonal"), (2, "full"), (2, "function"), (30_000, "diagonal")])
def test_no_metric_hides_a_contradiction_from_a_step(formulation: str, metric: str, n: int) -> None:
    gradients = np.zeros((2, 4, n))
    gradients[:, 1:, :2] = WEDGE
    M = np.append(STRETCH, np.ones(n - 2))
    given = np.diag(M) if metric == "full" else M if metric == "diagonal" else M.__mul__
    step = ConstrainedStep(formulation=formulation, metric=given, step_size=1.0, restoration_rate=1.0)
    result = step(Linearization([[0.0, 0.0, 0.0, -1.0], [0.0, 0.0, 0.0, 0.0]], gradients), np.zeros(3))
    assert result.counts["infeasible"].tolist() == [1, 0]
    assert np.isnan(result.residuals).all(axis=1).tolist() == [True, False]  # an optimum in M alone is none
    assert formulation == "cone" or not result.stationary[0]


@pytest.mark.parametrize("climb", [1.0, 1e3, 1e8])
@pytest.mark.parametrize("slack", [-1e-8, -1e-6])
def test_no_steep_objective_hides_one_from_a_step(climb: float, slack: float) -> None:
    linearization = Linearization([0.0, 0.0, slack], [[0.0, climb, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    result = ConstrainedStep(formulation="restoring")(linearization, [0.0, 0.0])
    assert result.counts["infeasible"] == 1
    assert result.change[0] == pytest.approx(0.01 * slack, rel=1e-6)


PLANE = np.array([[2.0, 1.0], [1.0, 2.0]])


@pytest.mark.parametrize(("tilt", "tolerance"), [(1e-6, 1e-12), (1e-3, 1e-8), (0.1, 1e-3)])
@pytest.mark.parametrize("radius", [None, 1e3])
def test_what_is_rounded_in_a_metrics_coordinates_is_no_contradiction(
    tilt: float, tolerance: float, radius: float | None
) -> None:
    settings = {"metric": PLANE.__matmul__, "metric_tolerance": tolerance, "radius": radius}
    problem = DirectionProblem([0.0, 0.0], [[-tilt, -1.0], [0.0, 1.0]], [1.0, -1.0], **settings)  # met by (0, −1)
    assert solve(problem).status in (Status.OPTIMAL, Status.UNCERTIFIED)
    if radius is None:
        assert farkas_residual(problem, np.ones(2)) >= tilt / 10


def test_what_is_met_far_away_is_no_contradiction_where_the_metric_is_a_function() -> None:
    """By (−1/tilt, −1), a million times the bounds away: a proof to √tolerance would say that nothing meets it."""
    for tilt in (1e-6, 1e-7):
        problem = DirectionProblem([0.0, 0.0], [[-tilt, -1.0], [0.0, 1.0]], [2.0, -1.0], metric=PLANE.__matmul__)
        assert solve(problem).status == Status.UNCERTIFIED
    given = Linearization([0.0, -1.0, 0.0], [[0.0, 0.0], [1e-6, -1.0], [0.0, 1.0]])
    settings = {"formulation": "restoring", "step_size": 1.0, "restoration_rate": 1.0, "metric": PLANE.__matmul__}
    result = ConstrainedStep(**settings)(given, [0.0, 0.0])
    assert (result.counts["infeasible"], result.counts["skipped"]) == (0, 1)
    with pytest.raises(DirectionError):
        ConstrainedStep(**settings, on_failure="raise")(given, [0.0, 0.0])


def test_an_infeasible_answer_says_up_to_which_length() -> None:
    """Feasible at length 4e15, and at no shorter one: "none shorter than bᵀy/‖Jᵀy‖" is true of both."""
    rows = np.array([[4.0, -2.0, -3.0], [-3.9999999999999996, 1.9999999999999998, 3.0]])
    answer = solve(DirectionProblem(np.zeros(3), rows, 1.0))
    assert answer.status == Status.INFEASIBLE
    assert "none shorter than bᵀy/‖Jᵀy‖" in str(answer.status)
    y = answer.multipliers
    assert 1e13 < y.sum() / np.linalg.norm(y @ rows) <= 5e15  # 4.03e15 but for rounding
