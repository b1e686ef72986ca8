"""Objects of the caller's own kind: two or three methods, and the answers of arrays; never a wrong OPTIMAL."""

import copy
import pickle
from typing import Any

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
    kkt_residuals,
    solve,
    solve_batch,
)

from .kinds import InPairs, Kept


def draw(seed: int, n: int = 9, m: int = 3) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((1 + m, n)), rng.uniform(-1.0, 0.5, m)


@pytest.mark.parametrize("radius", [None, 0.7])
def test_wrong_directions_are_told_from_right_ones(radius: float | None) -> None:
    problem = DirectionProblem(Kept(draw(0)[0]), radius=radius)
    answer = solve(problem)
    assert kkt_residuals(problem, answer).worst <= 1e-12
    wrong = Direction(answer.value + 0.1, answer.multipliers, Status.OPTIMAL, 0, answer.radius_multiplier)
    assert kkt_residuals(problem, wrong).worst > 1e-3


@pytest.mark.parametrize("formulation", ["equality", "cone", "restoring", "linearized"])
def test_steps_are_those_of_arrays(formulation: str) -> None:
    V, values = draw(2)[0], np.array([0.0, -0.5, 0.25, -1.0])
    step = ConstrainedStep(formulation=formulation)
    expected, result = (step(Linearization(values, each), np.zeros(3)) for each in (V, Kept(V)))
    np.testing.assert_allclose(result.change, expected.change, atol=1e-12)
    np.testing.assert_array_equal(result.active, expected.active)
    np.testing.assert_allclose(result.predicted_slack, expected.predicted_slack, atol=1e-12)


NEAR = np.array([[1.0, 2.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0], [-1.0, 1e-3, 0.0, 0.0]])
NEARER = np.array([[1.0, 2.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0], [-1.0, 5e-4, 0.0, 0.0]])
TWICE = np.array([[1.0, 2.0, 3.0, 4.0], [-1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize("V", [NEAR, NEARER])
def test_rows_that_nearly_depend_need_pairs(V: np.ndarray) -> None:
    expected = solve(DirectionProblem(V[0], V[1:], [0.5, 0.5]))
    answer = solve(DirectionProblem(InPairs(V), bound=[0.5, 0.5]))
    assert (answer.status, answer.rung) == (Status.OPTIMAL, "pairs")
    np.testing.assert_allclose(answer.value, expected.value, rtol=1e-10)
    without = DirectionProblem(Kept(V), bound=[0.5, 0.5])
    assert solve(without).status == Status.UNCERTIFIED
    linearization = Linearization([0.0, -0.5, -0.5], Kept(V))
    result = ConstrainedStep()(linearization, [0.0, 0.0])
    assert result.counts["skipped"] == 1
    np.testing.assert_array_equal(result.change, np.zeros(4))
    with pytest.raises(DirectionError):
        ConstrainedStep(on_failure="raise")(linearization, [0.0, 0.0])
    again = ConstrainedStep()(Linearization([0.0, -0.5, -0.5], InPairs(V)), [0.0, 0.0])
    assert again.counts["skipped"] == 0


def sum_to_zero(seed: int) -> np.ndarray:
    V = draw(seed, 200)[0]
    V[3] = -V[1] - V[2]
    return V


@pytest.mark.parametrize("V", [TWICE, sum_to_zero(0), sum_to_zero(1), draw(5, n=2)[0]])
def test_rows_that_depend_need_no_pairs(V: np.ndarray) -> None:
    bound = np.full(len(V) - 1, -0.25)
    for settings in ({}, {"equality": True, "bound": 0.0}, {"radius": 0.5}):
        arguments = {"bound": bound, **settings}
        expected = solve(DirectionProblem(V[0], V[1:], **arguments))
        answer = solve(DirectionProblem(Kept(V), **arguments))
        assert answer.status == expected.status == Status.OPTIMAL
        assert answer.rung == "gramian"
        np.testing.assert_allclose(answer.value, expected.value, atol=1e-10 * float(np.linalg.norm(V[0])))
    values = np.append(0.0, bound)
    expected, result = (ConstrainedStep()(Linearization(values, each), 0.0 * bound) for each in (V, Kept(V)))
    np.testing.assert_allclose(result.change, expected.change, atol=1e-10)


OPPOSING = np.array([[0.0, 0.0, 3.0, 4.0], [1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize("theta", [1e-7, 1e-8])
def test_rows_that_seem_to_contradict_each_other_are_not_called_infeasible(theta: float) -> None:
    V = OPPOSING.copy()
    V[2, 1] = theta
    assert solve(DirectionProblem(V[0], V[1:], 1.0)).status == Status.OPTIMAL
    assert solve(DirectionProblem(Kept(V), bound=1.0)).status == Status.UNCERTIFIED
    assert solve(DirectionProblem(InPairs(V), bound=1.0)).status == Status.OPTIMAL


class Wrong(Kept):
    def lincomb(self, weights: np.ndarray) -> Any:
        return weights @ self.V * 1.001


def test_a_combination_that_is_off_is_not_certified() -> None:
    V, bound = draw(1)
    answer = solve(DirectionProblem(Wrong(V), bound=bound))
    assert (answer.status, answer.residuals) == (Status.UNCERTIFIED, None)
    np.testing.assert_allclose(answer.value, solve(DirectionProblem(V[0], V[1:], bound)).value, rtol=2e-3)


def test_rows_of_zero_are_told_from_short_ones() -> None:
    V = np.array([[1.0, 2.0], [0.0, 0.0], [-1e-200, 0.0]])
    assert solve(DirectionProblem(Kept(V[:2]))).status == Status.OPTIMAL
    assert solve(DirectionProblem(Kept(V))).status == Status.UNCERTIFIED


class ThirdParty:
    def solve(self, problem: DirectionProblem) -> Direction:
        assert type(problem.gradient) is np.ndarray
        return SOLVERS["active-set"].solve(problem)


def test_a_third_partys_solver_sees_coordinates() -> None:
    V, bound = draw(1)
    expected = solve(DirectionProblem(V[0], V[1:], bound)).value
    for solver in (ThirdParty(), WithGeometry(ThirdParty())):
        answer = solve(DirectionProblem(Kept(V), bound=bound), solver)
        assert answer.status == Status.OPTIMAL
        np.testing.assert_allclose(answer.value, expected, atol=1e-12)


def test_copies_and_pickles() -> None:
    V, bound = draw(1)
    problem = DirectionProblem(Kept(V), bound=bound)
    expected = solve(problem).value
    for again in (copy.copy(problem), copy.deepcopy(problem), pickle.loads(pickle.dumps(problem))):
        np.testing.assert_array_equal(solve(again).value, expected)
    linearization = pickle.loads(pickle.dumps(Linearization([0.0, -1.0, 1.0, 1.0], Kept(V))))
    assert ConstrainedStep()(linearization, np.zeros(3)).counts["skipped"] == 0


class Odd(Kept):
    def gramian(self) -> np.ndarray:
        return np.triu(self.V @ self.V.T)


def test_what_does_not_fit_is_refused() -> None:
    V = draw(0)[0]
    with pytest.raises(ValueError, match=r"gramian\(\) should be symmetric"):
        DirectionProblem(Odd(V))
    with pytest.raises(ValueError, match="gradient and jacobian should be finite, and their squares too"):
        DirectionProblem(Kept(V * np.nan))
    with pytest.raises(ValueError, match="gradient and jacobian should be finite, and their squares too"):
        Linearization(np.zeros(4), Kept(V * 1e200))
    with pytest.raises(ValueError, match="jacobian should not be given where gradient is an object"):
        DirectionProblem(Kept(V), V[1:])
    with pytest.raises(ValueError, match="metric should be None where gradient is an object"):
        DirectionProblem(Kept(V), metric=np.ones(9))
    for ask in (lambda each: each.jacobian, lambda each: each.objective_gradient):
        with pytest.raises(ValueError, match="gradients should be an array, or trees of arrays; found"):
            ask(Linearization(np.zeros(4), Kept(V)))
    with pytest.raises(ValueError, match=r"problems should have one shape; found \[\(\)\]"):
        solve_batch("active-set", [DirectionProblem(Kept(V))])


class Fixed(Kept):
    def lincomb(self, weights: np.ndarray) -> Any:  # noqa: ARG002
        return self.V[0]


FAULTS = [
    ("gramian", None, r"gramian\(\) should be an array of real numbers"),
    ("lincomb", None, r"lincomb\(\) should return something; found None"),
    ("lincomb", np.ones((2, 3)), r"extended\(\) should take what lincomb\(\) returns; found that ndarray is"),
    ("extended", 1.0, r"extended\(\) should return an object with gramian, lincomb and extended; found 1.0"),
    ("extended", Kept(NEAR), r"lincomb\(\) should take 4 weights; found that ndarray is an error: matmul"),
    ("extended", Fixed(NEAR), r"gramian\(\) of what extended\(\) returns should have shape \(5, 5\); found \(3, 3\)"),
    ("gramian_in_pairs", None, r"gramian_in_pairs\(\) should be an array of real numbers"),
]


@pytest.mark.parametrize(("method", "found", "message"), FAULTS)
def test_a_method_that_is_wrong_is_named(method: str, found: Any, message: str) -> None:
    in_pairs = method.endswith("in_pairs")
    given = (InPairs if in_pairs else Kept)(NEAR)
    setattr(given, method, lambda *_: found)
    with pytest.raises(ValueError, match=message):
        solve(DirectionProblem(given, bound=[0.5] * (1 if method == "gramian" else 2)))
