"""The shared preparation: scaling, reduction, polishing, retries, and the proof of infeasibility."""

import numpy as np
import pytest

from cpgrl_opt.certify import farkas_residual, kkt_residuals
from cpgrl_opt.comparison.families import FAMILIES
from cpgrl_opt.direction import Status
from cpgrl_opt.problem import DirectionProblem
from cpgrl_opt.solvers import SOLVERS, is_usable
from cpgrl_opt.solvers.infeasibility import infeasible_direction
from cpgrl_opt.solvers.nnls import least_distance
from cpgrl_opt.solvers.pipeline import solve_by
from cpgrl_opt.solvers.small_problem import SmallAnswer, SmallProblem

TOLERANCE = 1e-9


def problem_of(seed: int, n: int = 50, m: int = 4) -> DirectionProblem:
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-6, 6, size=(m, 1))
    return DirectionProblem(rng.normal(size=n), rows, rows @ rng.normal(size=n))


def test_a_row_too_slack_to_matter_comes_back_when_the_answer_violates_it() -> None:
    # A wedge of angle t pushes d to about 2/t along the second axis; the third row stops it there at a cost.
    t = 1e-3
    rows = [[1, 0, 0], [-np.cos(t), np.sin(t), 0], [0, -1, 0.3]]
    problem = DirectionProblem([0.1, 0.2, 0.3], rows, [1, 1, -1.9e3])
    seen: list[int] = []

    def counting(small: SmallProblem) -> SmallAnswer:
        seen.append(len(small.bound))
        return least_distance(small)

    answer = solve_by(counting, problem, tolerance=TOLERANCE)
    assert seen == [2, 3]
    assert answer.status == Status.OPTIMAL
    assert answer.multipliers[2] > 0.0


def blurred(size: float, seed: int = 0) -> "object":
    """least_distance with an error of `size` in x and μ, as a first-order method leaves it."""
    rng = np.random.default_rng(seed)

    def back_end(small: SmallProblem) -> SmallAnswer:
        exact = least_distance(small)
        assert exact.point is not None
        assert exact.multipliers is not None
        return SmallAnswer(
            exact.point + size * rng.normal(size=exact.point.shape),
            exact.multipliers + size * rng.random(size=exact.multipliers.shape),
        )

    return back_end


@pytest.mark.parametrize("seed", range(5))
def test_polishing_certifies_what_a_first_order_method_found(seed: int) -> None:
    problem = problem_of(seed)
    back_end = blurred(1e-6, seed)
    raw = solve_by(back_end, problem, tolerance=TOLERANCE, polished=False)  # type: ignore[arg-type]
    better = solve_by(back_end, problem, tolerance=TOLERANCE)  # type: ignore[arg-type]
    assert raw.status == Status.UNCERTIFIED
    assert better.status == Status.OPTIMAL
    assert kkt_residuals(problem, better).worst <= 1e-13


@pytest.mark.parametrize("named", [[1.0, 0.0], [0.0, 1.0], [0.5, 0.2], [0.0, 0.0]])
def test_polishing_corrects_the_face_where_a_row_is_nearly_tight(named: list[float]) -> None:
    """d = (0, 1) on the first row; the second is 1e-8 away. The back end's multipliers name either, both or none."""

    def back_end(small: SmallProblem) -> SmallAnswer:
        return SmallAnswer(least_distance(small).point, np.array(named))

    answer = solve_by(back_end, DirectionProblem([1.0, 1.0], [[-1, 0], [-1, 1e-8]]), tolerance=TOLERANCE)
    assert answer.status == Status.OPTIMAL
    np.testing.assert_allclose(answer.value, [0.0, 1.0], atol=1e-15)


@pytest.mark.parametrize("failure", [Status.INFEASIBLE, Status.NUMERICAL_ERROR, Status.ITERATION_LIMIT])
def test_a_feasible_problem_is_not_infeasible_because_a_back_end_says_so(failure: Status) -> None:
    gives_up = SmallAnswer(None, None, failure=failure)
    answer = solve_by(lambda _: gives_up, problem_of(4), tolerance=TOLERANCE)
    assert answer.status == (Status.ITERATION_LIMIT if failure == Status.ITERATION_LIMIT else Status.NUMERICAL_ERROR)
    assert not answer.value.any()


def test_an_answer_that_is_not_a_number_is_a_numerical_error() -> None:
    def back_end(small: SmallProblem) -> SmallAnswer:
        return SmallAnswer(np.full(small.center.shape, np.nan), np.zeros(small.bound.shape))

    answer = solve_by(back_end, problem_of(5), tolerance=TOLERANCE)
    assert answer.status == Status.NUMERICAL_ERROR
    assert not answer.value.any()


def test_a_back_end_that_misses_a_far_answer_is_asked_again_in_larger_units() -> None:
    sizes: list[float] = []

    def short_sighted(small: SmallProblem) -> SmallAnswer:
        sizes.append(float(small.bound.max()))
        answer = least_distance(small)
        assert answer.point is not None
        return answer if np.abs(answer.point).max() < 10 else SmallAnswer(None, None, failure=Status.INFEASIBLE)

    t = 1e-5
    problem = DirectionProblem([1.0, 0, 1], [[1, 0, 0], [-np.cos(t), np.sin(t), 0]], [1, 1])
    answer = solve_by(short_sighted, problem, tolerance=TOLERANCE)
    assert answer.status == Status.OPTIMAL
    assert len(sizes) == 3
    assert sizes[2] == pytest.approx(1e-6 * sizes[0])


@pytest.mark.parametrize("gap", [0.0, 1e-3, 1.0])  # ‖d‖ is 1e8: a gap of 1e-7 would be met to 1e-15 of it
@pytest.mark.parametrize("seed", range(4))
def test_rows_that_nearly_depend_do_not_blur_the_proof_of_rows_that_do(gap: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    t = 1e-8
    rows = np.array([[1, 0, 0, 0, 0, 0], [-np.cos(t), np.sin(t), 0, 0, 0, 0], [0, 0, 1, 2, 0, 0], [0, 0, -1, -2, 0, 0]])
    problem = DirectionProblem(rng.normal(size=6), rows @ Q, [1, 1, gap, 0])
    least = infeasible_direction(problem)
    if gap == 0.0:
        assert least is None
    else:
        assert least is not None
        assert farkas_residual(problem, least.multipliers) <= 1e-6
        np.testing.assert_allclose(least.multipliers[:2], 0.0, atol=1e-15)


def test_bounds_that_differ_by_rounding_do_not_make_a_problem_infeasible() -> None:
    problem = DirectionProblem([1.0, 2], [[1, 0], [1, 0]], [1.0, 1.0 + 1e-13], True)
    assert infeasible_direction(problem) is None


@pytest.mark.parametrize("name", ["nnls", "enumeration", "osqp", "clarabel"])
@pytest.mark.parametrize(
    ("family", "seed"), [("opposing-1e-8", 10), ("opposing-1e-8", 0), ("parallel-1e-8-equality", 2)]
)
def test_polished_answers_are_those_of_the_rows_as_given(name: str, family: str, seed: int) -> None:
    """Rounded unit rows tilt a face by eps/θ: a back end's own answer, with a smaller residual, was 1 % off."""
    if not is_usable(SOLVERS[name]):
        pytest.skip(f"{name} is not installed")
    problem = FAMILIES[family].problem(0, seed)
    answer, exact = SOLVERS[name].solve(problem), SOLVERS["active-set"].solve(problem)
    assert answer.status == Status.OPTIMAL
    assert np.linalg.norm(answer.value - exact.value) <= 1e-9 * np.linalg.norm(problem.gradient)


def test_polishing_does_not_hide_a_wrong_answer() -> None:
    def idle(small: SmallProblem) -> SmallAnswer:
        return SmallAnswer(small.center.copy(), np.zeros(len(small.bound)))

    problem = problem_of(0)
    answer = solve_by(idle, problem, tolerance=TOLERANCE)
    assert answer.status == Status.UNCERTIFIED
    assert kkt_residuals(problem, answer).worst > 0.1
