"""The rational reference against problems solved by hand, and against every active set in float64."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cpgrl_opt import SOLVERS, DirectionProblem, Status
from cpgrl_opt.exact import exact_answer, is_small_enough

HALF_PLANE, OPPOSING, DIAGONAL = [[0.0, 1.0]], [[0.0, 1.0], [1.0, 1.0]], [[1.0, 0.0], [1.0, 1.0]]
# g, J, settings → d*, μ.
BY_HAND = {
    # (3, −4) onto y ≥ 0: the second coordinate goes.
    "a half plane": ([3.0, -4.0], HALF_PLANE, {}, [3.0, 0.0], [4.0]),
    "a bound that g meets": ([3.0, 4.0], HALF_PLANE, {"bound": [4.0]}, [3.0, 4.0], [0.0]),
    # x ≥ 1, x + y ≥ 3 from (0, 0): (1.5, 1.5) on the diagonal, and x ≥ 1 is slack; with x ≥ 2, the corner (2, 1).
    "a diagonal": ([0.0, 0.0], DIAGONAL, {"bound": [1.0, 3.0]}, [1.5, 1.5], [0.0, 1.5]),
    "a corner": ([0.0, 0.0], DIAGONAL, {"bound": [2.0, 3.0]}, [2.0, 1.0], [1.0, 1.0]),
    # x + y = 0 from (2, 0): (1, −1), and μ = −1, which an inequality would not allow.
    "an equality": ([2.0, 0.0], [[1.0, 1.0]], {"equality": True}, [1.0, -1.0], [-1.0]),
    "an inequality": ([2.0, 0.0], [[1.0, 1.0]], {}, [2.0, 0.0], [0.0]),
    "rows off": ([3.0, -4.0], OPPOSING, {"bound": [-np.inf, -np.inf]}, [3.0, -4.0], [0.0, 0.0]),
    "no rows": ([3.0, -4.0], np.zeros((0, 2)), {}, [3.0, -4.0], []),
    # M = diag(1, 4): M⁻¹g = (3, −1). d₂ ≥ 1 pushes by μ/4 upward; d₁ + d₂ ≥ 4 by μ(1, ¼).
    "a diagonal metric": ([3.0, -4.0], HALF_PLANE, {"bound": [1.0], "metric": [1.0, 4.0]}, [3.0, 1.0], [8.0]),
    "a full metric": (
        [3.0, -4.0], [[1.0, 1.0]], {"bound": [4.5], "metric": [[1.0, 0.0], [0.0, 4.0]]}, [5.0, -0.5], [2.0]
    ),
    "a ball": (
        [3.0, 4.0], [[-1.0, 0.0]], {"bound": [-3.0], "radius": 10.0}, [3.0, 91.0**0.5], [3 - 12 / 91**0.5]
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BY_HAND)
def test_answers_by_hand(name: str) -> None:
    gradient, jacobian, settings, direction, multipliers = BY_HAND[name]
    answer = exact_answer(DirectionProblem(gradient, jacobian, **settings))
    assert answer.feasible
    np.testing.assert_array_equal(answer.direction, direction)
    np.testing.assert_array_equal(answer.multipliers, multipliers)


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


@pytest.mark.parametrize(
    ("jacobian", "settings", "is_feasible"),
    [
        ([[1.0, 0.0], [3.0, 0.0]], {"bound": [1.0, 2.0], "equality": True}, False),
        ([[0.0, 0.0]], {"bound": [1e-300]}, False),
        ([[0.0, 0.0]], {"bound": [-1e-300], "equality": True}, False),
        ([[0.0, 0.0]], {"bound": [-1e-300]}, True),
        ([[1.0, 0.0]], {"bound": [3.0], "radius": 2.0}, False),
    ],
)
def test_contradicting_equalities_zero_rows_and_a_ball_out_of_reach(
    jacobian: list, settings: dict, is_feasible: bool
) -> None:
    assert exact_answer(DirectionProblem([3.0, 4.0], jacobian, **settings)).feasible == is_feasible


def test_large_problems_are_refused() -> None:
    with pytest.raises(ValueError, match="m ≤ 8 and n ≤ 100, or 20 in a full metric; found m = 9, n = 2"):
        exact_answer(DirectionProblem([1.0, 0.0], np.ones((9, 2))))
    assert is_small_enough(DirectionProblem(np.ones(21), np.ones((1, 21)), metric=np.ones(21)))
    assert not is_small_enough(DirectionProblem(np.ones(21), np.ones((1, 21)), metric=np.eye(21)))


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
