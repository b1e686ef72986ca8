"""The rational reference against problems solved by hand, and against every active set in float64."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.exact import exact_answer, is_small_enough


def check(problem: DirectionProblem, direction: list[float], multipliers: list[float]) -> None:
    answer = exact_answer(problem)
    assert answer.feasible
    np.testing.assert_array_equal(answer.direction, direction)
    np.testing.assert_array_equal(answer.multipliers, multipliers)


def test_a_half_plane() -> None:
    # (3, −4) onto y ≥ 0: the second coordinate goes.
    check(DirectionProblem([3.0, -4.0], [[0.0, 1.0]]), [3.0, 0.0], [4.0])


def test_a_bound_that_g_meets_changes_nothing() -> None:
    check(DirectionProblem([3.0, 4.0], [[0.0, 1.0]], [4.0]), [3.0, 4.0], [0.0])


def test_a_corner() -> None:
    # x ≥ 1, x + y ≥ 3 from (0, 0): (1.5, 1.5) on the diagonal, and x ≥ 1 is slack; with x ≥ 2, the corner (2, 1).
    check(DirectionProblem([0.0, 0.0], [[1.0, 0.0], [1.0, 1.0]], [1.0, 3.0]), [1.5, 1.5], [0.0, 1.5])
    check(DirectionProblem([0.0, 0.0], [[1.0, 0.0], [1.0, 1.0]], [2.0, 3.0]), [2.0, 1.0], [1.0, 1.0])


def test_an_equality_may_have_either_sign() -> None:
    # x + y = 0 from (2, 0): (1, −1), and μ = −1, which an inequality would not allow.
    check(DirectionProblem([2.0, 0.0], [[1.0, 1.0]], equality=True), [1.0, -1.0], [-1.0])
    check(DirectionProblem([2.0, 0.0], [[1.0, 1.0]]), [2.0, 0.0], [0.0])


def test_no_rounding_at_a_millionth_of_a_millionth() -> None:
    # d₂ ≥ θ d₁ and d₂ ≤ −θ d₁ leave d₁ ≤ 0: from (1, 0) only the origin, for θ as small as float64 has them.
    theta = 2.0**-500
    answer = exact_answer(DirectionProblem([1.0, 0.0], [[-theta, 1.0], [-theta, -1.0]]))
    assert answer.feasible
    assert not answer.direction.any()


def test_a_proof_of_infeasibility() -> None:
    # x ≥ 1 and −2x ≥ −1: 2·1 + 1·(−1) = 1 > 0. The third row has no part in it.
    answer = exact_answer(DirectionProblem([5.0, 5.0], [[1.0, 0.0], [-2.0, 0.0], [0.0, 1.0]], [1.0, -1.0, 0.0]))
    assert not answer.feasible
    np.testing.assert_array_equal(answer.multipliers, [2.0, 1.0, 0.0])
    # The last float64 below it is feasible.
    barely = DirectionProblem([5.0, 5.0], [[1.0, 0.0], [-2.0, 0.0]], [1.0, -2.0])
    assert exact_answer(barely).feasible
    too_much = DirectionProblem([5.0, 5.0], [[1.0, 0.0], [-2.0, 0.0]], [1.0, np.nextafter(-2.0, 0.0)])
    assert not exact_answer(too_much).feasible


def test_contradicting_equalities_and_impossible_zero_rows() -> None:
    assert not exact_answer(DirectionProblem([0.0], [[1.0], [3.0]], [1.0, 2.0], equality=True)).feasible
    assert not exact_answer(DirectionProblem([0.0], [[0.0]], [1e-300])).feasible
    assert not exact_answer(DirectionProblem([0.0], [[0.0]], [-1e-300], equality=True)).feasible
    assert exact_answer(DirectionProblem([0.0], [[0.0]], [-1e-300])).feasible


def test_switched_off_rows_and_no_rows() -> None:
    check(DirectionProblem([3.0, -4.0], [[0.0, 1.0], [1.0, 1.0]], [-np.inf, -np.inf]), [3.0, -4.0], [0.0, 0.0])
    check(DirectionProblem([3.0, -4.0], np.zeros((0, 2))), [3.0, -4.0], [])


def test_large_problems_are_refused() -> None:
    with pytest.raises(ValueError, match="m ≤ 8 and n ≤ 100, or 20 in a full metric; found m = 9, n = 2"):
        exact_answer(DirectionProblem([1.0, 0.0], np.ones((9, 2))))
    assert is_small_enough(DirectionProblem(np.ones(21), np.ones((1, 21)), metric=np.ones(21)))
    assert not is_small_enough(DirectionProblem(np.ones(21), np.ones((1, 21)), metric=np.eye(21)))


@pytest.mark.parametrize("metric", [[1.0, 4.0], [[1.0, 0.0], [0.0, 4.0]]])
def test_a_metric_divides_the_gradient_and_turns_the_way_back(metric: list) -> None:
    # M = diag(1, 4): M⁻¹g = (3, −1). d₂ ≥ 1 pushes by μ/4 upward; d₁ + d₂ ≥ 4 by μ(1, ¼).
    check(DirectionProblem([3.0, -4.0], [[0.0, 1.0]], [1.0], metric=metric), [3.0, 1.0], [8.0])
    check(DirectionProblem([3.0, -4.0], [[1.0, 1.0]], [4.5], metric=metric), [5.0, -0.5], [2.0])


def test_a_ball_is_left_to_the_search_in_it() -> None:
    check(DirectionProblem([3.0, 4.0], [[-1.0, 0.0]], [-3.0], radius=10.0), [3.0, 91.0**0.5], [3 - 12 / 91**0.5])
    assert not exact_answer(DirectionProblem([3.0, 4.0], [[1.0, 0.0]], [3.0], radius=2.0)).feasible


@st.composite
def integer_problems(draw: st.DrawFn) -> DirectionProblem:
    n, m = draw(st.integers(1, 4)), draw(st.integers(1, 6))
    numbers = st.integers(-2, 2)
    rows = draw(st.lists(st.lists(numbers, min_size=n, max_size=n), min_size=m, max_size=m))
    gradient, bound = draw(st.lists(numbers, min_size=n, max_size=n)), draw(st.lists(numbers, min_size=m, max_size=m))
    equality = draw(st.lists(st.booleans(), min_size=m, max_size=m))
    return DirectionProblem(
        np.array(gradient, float), np.array(rows, float), np.array(bound, float), np.array(equality)
    )


@settings(max_examples=40)
@given(problem=integer_problems())
def test_it_agrees_with_enumeration_on_integers(problem: DirectionProblem) -> None:
    answer, float_answer = exact_answer(problem), SOLVERS["enumeration"].solve(problem)
    assert float_answer.status == (Status.OPTIMAL if answer.feasible else Status.INFEASIBLE)
    if answer.feasible:
        np.testing.assert_allclose(float_answer.value, answer.direction, atol=1e-12)
        return
    y = answer.multipliers
    np.testing.assert_allclose(y @ problem.jacobian, 0.0, atol=1e-14)
    assert y @ problem.bound > 0
    assert (y[~problem.equality] >= 0).all()
