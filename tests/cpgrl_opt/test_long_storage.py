"""Long vectors are read where they lie, in any storage, and as they are when they are read."""

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem, Status

from .long import STORAGES, distance, on_rows

pytestmark = pytest.mark.usefixtures("every_problem_is_long")
ACTIVE_SET = SOLVERS["active-set"]
WIDE = np.random.default_rng(3).standard_normal((8, 300))


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("columns", [300, 1024, 30_000])
def test_storage_of_any_strides_gives_the_answer_of_a_contiguous_copy(storage, columns):
    V = np.random.default_rng(3).standard_normal((4, columns))
    g, J = STORAGES[storage](V[:1])[0], STORAGES[storage](V[1:])
    before = g.copy(), np.array(J)
    problem = DirectionProblem(g, J, [0.1, -0.2, 0.3])
    assert np.shares_memory(problem.gradient, g)
    is_apart = storage.startswith("rows apart")
    assert is_apart or np.shares_memory(problem.jacobian, J)
    for name in ("active-set", "nnls"):
        answer = SOLVERS[name].solve(problem)
        plain = SOLVERS[name].solve(DirectionProblem(V[0].copy(), V[1:].copy(), [0.1, -0.2, 0.3]))
        assert answer.rung == plain.rung == "gramian"
        assert distance(problem, answer, plain) <= 1e-14
        assert answer.multipliers == pytest.approx(plain.multipliers, rel=1e-12, abs=1e-14)
        assert not np.shares_memory(answer.value, g)
    np.testing.assert_array_equal(g, before[0])
    np.testing.assert_array_equal(J, before[1])
    assert ("jacobian" in vars(problem)) != is_apart  # which is put together when asked for
    np.testing.assert_array_equal(problem.jacobian, J)
    assert not problem.gradient.flags.writeable
    assert not problem.jacobian.flags.writeable
    sizes = np.linspace(1.0, 4.0, columns)
    in_metric, plain = (
        ACTIVE_SET.solve(DirectionProblem(V[0], rows, [0.1, -0.2, 0.3], metric=sizes)).value for rows in (J, V[1:])
    )
    np.testing.assert_allclose(in_metric, plain, rtol=0, atol=1e-12)


def test_short_problems_are_copied():
    with on_rows():
        assert not np.shares_memory(DirectionProblem(WIDE[0], WIDE[1:4]).jacobian, WIDE)
    few = WIDE[:, :16]
    assert not np.shares_memory(DirectionProblem(few[0], few[1:4]).jacobian, WIDE)  # n = 4 (1 + m)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda rows: [*rows[:4], rows[4][:-1]], "rectangular"),
        (lambda rows: np.vstack([*rows[:4], np.full(300, np.nan)]), "jacobian should be finite; found nan"),
        (lambda rows: [row[:-1] for row in rows], "gradient should have shape"),
    ],
)
def test_bad_rows_are_refused(spoil, message):
    with pytest.raises(ValueError, match=message):
        DirectionProblem(WIDE[0], spoil(WIDE[1:6]))


CHANGES = {
    "doubled": lambda V: np.multiply(V, 2.0, out=V),
    "one row much shorter": lambda V: np.multiply(V[2], 1e-11, out=V[2]),
    "one row turned": lambda V: np.copyto(V[2], WIDE[7]),
    "very last digits": lambda V: np.multiply(V, 1.0 + 1e-9 * WIDE[:4], out=V),
    "gradient": lambda V: np.copyto(V[0], WIDE[7]),
    "nothing left": lambda V: np.copyto(V, 0.0),
    "no number": lambda V: np.copyto(V[2, 3:4], np.nan),
}


@pytest.mark.parametrize("change", CHANGES)
def test_arrays_that_change_under_a_problem_never_make_a_wrong_answer_optimal(change):
    """Inner products are of the old arrays; the certificate is of those that d is made of."""
    V = WIDE[:4].copy()
    problem = DirectionProblem(V[0], V[1:], [0.2, 0.4, -0.3])
    CHANGES[change](V)
    answer = ACTIVE_SET.solve(problem)
    if not np.isfinite(V).all():
        assert answer.status not in (Status.OPTIMAL, Status.INFEASIBLE)
        return
    with on_rows():
        right = ACTIVE_SET.solve(DirectionProblem(V[0], V[1:], [0.2, 0.4, -0.3]))
    assert answer.status == right.status
    assert distance(problem, answer, right) <= 1e-13


def test_arrays_that_change_under_a_problem_do_not_stay_infeasible():
    V = WIDE[:5].copy()
    V[2] = -2.0 * V[1]
    problem = DirectionProblem(V[0], V[1:], [1.0, -1.0, 0.3, -1.0])
    assert ACTIVE_SET.solve(problem).status == Status.INFEASIBLE
    V[2] = WIDE[7]
    assert ACTIVE_SET.solve(problem).status == Status.OPTIMAL
