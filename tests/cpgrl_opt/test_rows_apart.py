"""Long rows in a list are looked at where they lie: the same problem and answer as of one array, without a copy."""

import copy
import pickle

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem, Status, kkt_residuals

N = 28_000  # n (1 + m)² > 10⁶ with five rows


def drawn() -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    rng = np.random.default_rng(7)
    return rng.standard_normal(N), [rng.standard_normal(N) for _ in range(5)], 10.0 * rng.standard_normal(5)


def test_the_answer_is_that_of_one_array_and_j_is_put_together_only_when_asked_for() -> None:
    g, rows, b = drawn()
    apart, whole = DirectionProblem(g, rows, b), DirectionProblem(g, np.array(rows), b)
    found, expected = (SOLVERS["active-set"].solve(problem) for problem in (apart, whole))
    assert found.status == expected.status == Status.OPTIMAL
    assert found.rung == expected.rung == "gramian"
    np.testing.assert_allclose(found.value, expected.value, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.multipliers > 0, expected.multipliers > 0)
    assert kkt_residuals(apart, found).worst < 1e-12
    assert (apart.m, apart.n) == (5, N)
    assert "jacobian" not in vars(apart)
    np.testing.assert_array_equal(apart.jacobian, rows)
    assert not apart.jacobian.flags.writeable
    assert apart.jacobian is apart.jacobian


def test_copies_and_pickles_hold_the_same_rows() -> None:
    g, rows, b = drawn()
    problem = DirectionProblem(g, tuple(rows), b)
    for same in (copy.copy(problem), copy.deepcopy(problem), pickle.loads(pickle.dumps(problem)), problem.copied()):
        np.testing.assert_array_equal(same.jacobian, rows)
        np.testing.assert_array_equal(same.bound, b)


def test_a_metric_sees_the_rows_too() -> None:
    g, rows, b = drawn()
    found = SOLVERS["active-set"].solve(DirectionProblem(g, rows, b, metric=np.full(N, 4.0)))
    expected = SOLVERS["active-set"].solve(DirectionProblem(g, np.array(rows), b, metric=np.full(N, 4.0)))
    np.testing.assert_allclose(found.value, expected.value, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda rows: [*rows[:4], rows[4][:-1]], "rectangular"),
        (lambda rows: [*rows[:4], np.full(N, np.nan)], "finite"),
        (lambda rows: [row[:-1] for row in rows], "gradient should have shape"),
    ],
)
def test_bad_rows_are_refused(spoil, message) -> None:
    g, rows, b = drawn()
    with pytest.raises(ValueError, match=message):
        DirectionProblem(g, spoil(rows), b)


def test_rows_of_numbers_are_taken_and_of_another_kind_refused() -> None:
    g, rows, b = drawn()
    of_lists = DirectionProblem(g[:3], [[1.0, 0.0, 0.0], np.array([0.0, 1.0, 0.0])], b[:2])
    assert of_lists.jacobian.shape == (2, 3)
    with pytest.raises(AttributeError, match="no attribute 'jacobians'"):
        _ = of_lists.jacobians  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="gradient's kind, arrays of float64; found float32"):
        DirectionProblem(g, [row.astype(np.float32) for row in rows], b)
