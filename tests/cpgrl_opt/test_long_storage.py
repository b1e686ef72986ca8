"""Long vectors are read where they lie, in any storage, and as they are when they are read."""

import pickle
from contextlib import contextmanager

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.vectors import _numpy as array_vectors

ACTIVE_SET = SOLVERS["active-set"]
WIDE = np.random.default_rng(3).standard_normal((8, 300))


@pytest.fixture(autouse=True)
def every_problem_is_long(monkeypatch):
    monkeypatch.setattr(array_vectors, "LEAST_PRODUCTS", 0)


@contextmanager
def on_rows():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(array_vectors, "LEAST_PRODUCTS", 10**18)
        yield


def drawn_problem(seed, equality=False):
    """Rows well apart, about half of them tight at the optimum."""
    rng = np.random.default_rng(seed)
    return DirectionProblem(
        rng.standard_normal(80), rng.standard_normal((4, 80)), 0.2 * rng.standard_normal(4), equality
    )


def distance(first, second):
    """‖d − d′‖ over the longer one."""
    size = max(np.linalg.norm(first.value), np.linalg.norm(second.value)) or 1.0
    return np.linalg.norm(first.value - second.value) / size


def nearly_opposing(n):
    """g and two rows 1e-6 rad from opposing each other, both of which bind; and a third."""
    first, second, third, fourth = np.linalg.qr(np.random.default_rng(5).standard_normal((n, 4)))[0].T
    other = np.sin(1e-6) * second - np.cos(1e-6) * first
    return np.array([fourth - 2.0 * second - third - 0.3 * first, 5.0 * first, 3.0 * other, third - 0.4 * first])


STORED = {
    "transposed": lambda V: (V[0], np.asfortranarray(V[1:])),
    "negative strides": lambda V: (V[0, ::-1].copy()[::-1], V[:0:-1, ::-1].copy()[::-1, ::-1]),
    "every second row": lambda V: (V[0], np.repeat(V[1:], 2, axis=0)[::2]),
    "every second column": lambda V: (np.repeat(V[0], 2)[::2], np.repeat(V[1:], 2, axis=1)[:, ::2]),
    "part of a longer array": lambda V: (V[0], np.hstack([V[1:], V[1:]])[:, : V.shape[1]]),
    "one array": lambda V: (V[0], V[1:]),
    "gradient apart": lambda V: (V.T.copy()[:, 0], V[1:]),
    "read-only": lambda V: tuple(np.frombuffer(part.tobytes()).reshape(part.shape) for part in (V[0], V[1:])),
}


@pytest.mark.parametrize("storage", STORED)
@pytest.mark.parametrize("columns", [300, 1024, 30_000])
def test_storage_of_any_strides_gives_the_answer_of_a_contiguous_copy(storage, columns):
    V = np.random.default_rng(3).standard_normal((4, columns))
    g, J = STORED[storage](V)
    before = g.copy(), J.copy()
    problem = DirectionProblem(g, J, [0.1, -0.2, 0.3])
    assert np.shares_memory(problem.gradient, g)
    assert np.shares_memory(problem.jacobian, J)
    assert not problem.gradient.flags.writeable
    assert not problem.jacobian.flags.writeable
    for name in ("active-set", "nnls"):
        answer = SOLVERS[name].solve(problem)
        plain = SOLVERS[name].solve(DirectionProblem(V[0].copy(), V[1:].copy(), [0.1, -0.2, 0.3]))
        assert answer.rung == plain.rung == "gramian"
        assert distance(answer, plain) <= 1e-14
        assert answer.multipliers == pytest.approx(plain.multipliers, rel=1e-12, abs=1e-14)
        assert not np.shares_memory(answer.value, g)
    assert (g == before[0]).all()
    assert (before[1] == J).all()


@pytest.mark.parametrize("storage", STORED)
def test_storage_of_any_strides_is_read_in_pairs_and_by_the_referee_too(storage):
    g, J = STORED[storage](nearly_opposing(9000))
    problem = DirectionProblem(g, J)
    answer = ACTIVE_SET.solve(problem)
    assert answer.rung == "pairs"
    plain = ACTIVE_SET.solve(DirectionProblem(g.copy(), np.array(J, order="C")))
    assert distance(answer, plain) <= 1e-14
    found = kkt_residuals(problem, answer)
    with on_rows():
        assert found.worst == pytest.approx(kkt_residuals(DirectionProblem(g, J), answer).worst, abs=1e-14)


def test_rows_as_a_list_and_single_precision_give_the_answer_of_an_array_in_double():
    single = WIDE[:4].astype(np.float32)
    V = single.astype(np.float64)
    plain = ACTIVE_SET.solve(DirectionProblem(V[0], V[1:]))
    for given_ in ((V[0], list(V[1:])), (V[0].tolist(), V[1:].tolist())):
        assert distance(ACTIVE_SET.solve(DirectionProblem(*given_)), plain) <= 1e-15
    answer = ACTIVE_SET.solve(DirectionProblem(single[0], single[1:]))
    np.testing.assert_array_equal(answer.value, plain.value.astype(np.float32))


def test_short_problems_are_copied_as_before():
    with on_rows():
        problem = DirectionProblem(WIDE[0], WIDE[1:4])
        assert not np.shares_memory(problem.jacobian, WIDE)
    few = WIDE[:, :16]
    assert not np.shares_memory(DirectionProblem(few[0], few[1:4]).jacobian, WIDE)  # n = 4 (1 + m)


def test_a_long_problem_survives_pickling_read_only():
    problem = drawn_problem(1)
    again = pickle.loads(pickle.dumps(problem))
    for name in ("gradient", "jacobian", "bound", "equality"):
        assert (getattr(problem, name) == getattr(again, name)).all()
        assert not getattr(again, name).flags.writeable
    assert (ACTIVE_SET.solve(again).value == ACTIVE_SET.solve(problem).value).all()


CHANGES = {
    "doubled": lambda V: np.multiply(V, 2.0, out=V),
    "one row shorter": lambda V: np.multiply(V[2], 1e-3, out=V[2]),
    "one row much shorter": lambda V: np.multiply(V[2], 1e-11, out=V[2]),
    "one row turned": lambda V: np.copyto(V[2], WIDE[7]),
    "one number": lambda V: np.copyto(V[1, :1], 3.0),
    "last digits": lambda V: np.multiply(V, 1.0 + 1e-7 * WIDE[:4], out=V),
    "very last digits": lambda V: np.multiply(V, 1.0 + 1e-9 * WIDE[:4], out=V),
    "gradient": lambda V: np.copyto(V[0], WIDE[7]),
    "nothing left": lambda V: np.copyto(V, 0.0),
    "no number": lambda V: np.copyto(V[2, 3:4], np.nan),
    "infinite": lambda V: np.copyto(V[0, 3:4], np.inf),
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
        fresh = DirectionProblem(V[0], V[1:], [0.2, 0.4, -0.3])
        right = ACTIVE_SET.solve(fresh)
    assert answer.status == right.status
    assert distance(answer, right) <= 1e-13


def test_arrays_that_change_under_a_problem_do_not_stay_infeasible():
    V = WIDE[:5].copy()
    V[2] = -2.0 * V[1]
    problem = DirectionProblem(V[0], V[1:], [1.0, -1.0, 0.3, -1.0])
    assert ACTIVE_SET.solve(problem).status == Status.INFEASIBLE
    V[2] = WIDE[7]
    assert ACTIVE_SET.solve(problem).status == Status.OPTIMAL


def test_arrays_put_in_the_place_of_a_problems_own_are_the_ones_looked_at():
    problem = drawn_problem(2)
    object.__setattr__(problem, "gradient", np.where(np.arange(problem.n) == 3, np.nan, problem.gradient))
    assert ACTIVE_SET.solve(problem).status not in (Status.OPTIMAL, Status.INFEASIBLE)
