"""The ladder's laws: what is solved in the coordinates of the span is what is solved on the rows, or exact rationals.

LEAST_PRODUCTS = 0 sends every problem with n > 4 (1 + m) through the ladder, a huge one none.
"""

import math
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.certify import excess_violation, farkas_residual, violation_tolerance
from cpgrl_opt.problem import ProblemBatch
from cpgrl_opt.scaling import lengths
from cpgrl_opt.solvers import is_usable, span, supports
from cpgrl_opt.testing import check_direction_solver
from cpgrl_opt.testing.families import HOSTILE, WELL_POSED
from cpgrl_opt.testing.strategies import ALL_CASES
from cpgrl_opt.vectors import _numpy as array_vectors

ACTIVE_SET = SOLVERS["active-set"]
IS_NIGHTLY = settings().max_examples >= 1000
EXAMPLES = settings().max_examples if IS_NIGHTLY else 5  # a family and a solver
OFTEN = ("active-set", "nnls", "quadprog", "osqp", "rosen")
EVERY_SOLVER = [name for name, solver in SOLVERS.items() if (IS_NIGHTLY or name in OFTEN) and is_usable(solver)]
# Those that end at an optimum, rather than near one.
EXACT_SOLVERS = ("active-set", "nnls", "enumeration", "rosen")
FAMILIES = [family for family in WELL_POSED if family.geometry is None]


@contextmanager
def least(products) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(array_vectors, "LEAST_PRODUCTS", products)
        yield


def long():
    return least(0)


def on_rows():
    return least(10**18)


@pytest.fixture(autouse=True)
def every_problem_is_long():
    with long():
        yield


def arrays(problem):
    return problem.gradient, problem.jacobian, problem.bound, problem.equality


def both(problem, solver=ACTIVE_SET):
    """The answers in the span and on the rows."""
    inside = solver.solve(DirectionProblem(*arrays(problem)))
    with on_rows():
        return inside, solver.solve(DirectionProblem(*arrays(problem)))


def sizes(problem, *directions):
    return max(float(lengths(each)) for each in (problem.gradient, *directions)) or 1.0


def distance(problem, first, second):
    """‖d − d′‖ in units of σ."""
    unit = sizes(problem, first.value, second.value)
    return float(lengths(first.value / unit - second.value / unit))


def repeated(problem):
    """(g g …), (J J …) and r b, r a power of two that makes it long: every inner product is r times what it was."""
    times = 2 ** math.ceil(math.log2((4 * (1 + problem.m) + 1) / problem.n) + 1)
    times = max(times, 1)
    g, J, b, equality = arrays(problem)
    return DirectionProblem(np.tile(g, times), np.tile(J, (1, times)), times * b, equality)


def rational(array):
    return np.vectorize(Fraction, otypes=[object])(np.asarray(array, dtype=np.float64))


def exact_direction(problem, active):
    """g + Jᵀμ with J_A d = b_A, in rationals; rounded once."""
    g, J, b = (rational(each) for each in (problem.gradient, problem.jacobian[active], problem.bound[active]))
    A, rest = J @ J.T, b - J @ g
    for i in range(len(A)):
        for j in range(len(A)):
            if j != i:
                factor = A[j, i] / A[i, i]
                A[j], rest[j] = A[j] - factor * A[i], rest[j] - factor * rest[i]
    return (g + (rest / A.diagonal()) @ J).astype(np.float64) if len(A) else problem.gradient


def assert_exact(problem, answer, *, error):
    """d to `error` of its own length, on the face that the multipliers name."""
    exact = exact_direction(problem, np.flatnonzero(answer.multipliers))
    assert answer.status == Status.OPTIMAL
    assert np.linalg.norm(answer.value - exact) <= error * np.linalg.norm(exact)


def active_set(problem, answer):
    """Rows with μ̂ > 1e-8 σ, where multipliers are unique; None where the rows that bind depend on each other."""
    units = np.where(problem.jacobian.any(axis=1), lengths(problem.jacobian), 1.0)
    sigma = sizes(problem, answer.value)
    binding = np.abs(problem.jacobian @ answer.value - problem.bound) <= 1e-8 * units * sigma
    rows = problem.jacobian[binding] / units[binding, None]
    if len(rows) and np.linalg.svd(rows, compute_uv=False)[-1] < 1e-4:
        return None
    return np.flatnonzero(np.abs(answer.multipliers) * units > 1e-8 * sigma).tolist()


def require_same(problem, name):
    solver = SOLVERS[name]
    if not supports(solver, problem):
        return
    inside, outside = both(problem, solver)
    if name in EXACT_SOLVERS:
        assert inside.status == outside.status
    if Status.OPTIMAL in (inside.status, outside.status):
        assert Status.INFEASIBLE not in (inside.status, outside.status)
    if inside.status == outside.status == Status.OPTIMAL:
        assert distance(problem, inside, outside) <= (1e-12 if name == "active-set" else 1e-10)
        assert active_set(problem, inside) == active_set(problem, outside)


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
def test_every_solver_answers_in_the_span_as_on_the_rows(family):
    @settings(max_examples=EXAMPLES, derandomize=True, database=None)
    @given(family.problems(tuple(case for case in ALL_CASES if case in family.cases)))
    def check(problem):
        for name in EVERY_SOLVER:
            require_same(repeated(problem), name)

    check()


def random_problem(seed, *, m=4, n=80, equality=False):
    """Rows well apart, about half of them tight at the optimum."""
    rng = np.random.default_rng(seed)
    return DirectionProblem(rng.standard_normal(n), rng.standard_normal((m, n)), 0.2 * rng.standard_normal(m), equality)


def at_angle(theta, *, sign=-1.0, n=120):
    """Two rows that bind, the second at θ from opposing the first or from parallel; and a third."""
    first, second, third, fourth = np.linalg.qr(np.random.default_rng(5).standard_normal((n, 4)))[0].T
    rows = [5.0 * first, 3.0 * (sign * np.cos(theta) * first + np.sin(theta) * second), third - 0.4 * first]
    return fourth - 2.0 * second - third + 0.3 * sign * first, np.array(rows)


@pytest.mark.parametrize("rungs", [("pairs",), ()], ids=["pairs", "rows"])
def test_a_rung_that_is_forced_where_it_is_not_needed_agrees(monkeypatch, rungs):
    for seed in range(20):
        problem = random_problem(seed, equality=[seed % 3 == 0, False, False, False])
        usual = ACTIVE_SET.solve(problem)
        assert usual.rung == "gramian"
        with monkeypatch.context() as patch:
            patch.setattr(span, "RUNGS", rungs)
            forced = ACTIVE_SET.solve(problem)
        assert forced.rung == (rungs or ("rows",))[0]
        assert forced.status == usual.status == Status.OPTIMAL
        assert distance(problem, forced, usual) <= 1e-13
        assert forced.multipliers == pytest.approx(usual.multipliers, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize(("epsilon", "rung"), [(10.0**-k, "gramian" if k < 4 else "pairs") for k in range(1, 13)])
def test_a_direction_much_shorter_than_the_gradient_is_exact(epsilon, rung):
    """‖d‖ = ε‖g‖: rung 1 is exact to rounding of g, the second to rounding of d."""
    rng = np.random.default_rng(1)
    J = rng.standard_normal((3, 100))
    outside = rng.standard_normal(100)
    outside -= np.linalg.pinv(J) @ (J @ outside)
    g = -np.array([1.0, 2.0, 1.0]) @ J
    problem = DirectionProblem(g + epsilon * np.linalg.norm(g) / np.linalg.norm(outside) * outside, J)
    answer = ACTIVE_SET.solve(problem)
    assert answer.rung == rung or epsilon == 1e-4
    assert np.linalg.norm(answer.value) == pytest.approx(epsilon * np.linalg.norm(g), rel=1e-3)
    assert_exact(problem, answer, error=2e-15 / (epsilon if answer.rung == "gramian" else 1.0))


@pytest.mark.parametrize("bound", [0.0, [0.3, -0.3, 0.1]])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("theta", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11])
def test_small_angles_between_rows_that_bind_cost_no_digits(theta, sign, bound):
    """Not even where b asks for d across the angle, of length 1/θ: what the coordinates round, K in pairs mends."""
    problem = DirectionProblem(*at_angle(theta, sign=sign), bound, True)
    answer = ACTIVE_SET.solve(problem)
    assert answer.rung == ("pairs" if theta > 3e-9 else "rows")
    assert_exact(problem, answer, error=max(1e-15, 1e-30 / theta**2))


def test_many_rows_that_nearly_depend_cost_no_digits():
    """Found by random search: 0.25 σ off, and OPTIMAL, when pivots of 1e-20 were taken for rows."""
    for seed, noise in enumerate((1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)):
        rng = np.random.default_rng(seed)
        J = rng.standard_normal((5, 2)) @ rng.standard_normal((2, 60)) + noise * rng.standard_normal((5, 60))
        problem = DirectionProblem(rng.standard_normal(60), J, J @ rng.standard_normal(60), True)
        answer = ACTIVE_SET.solve(problem)
        assert_exact(problem, answer, error=1e-13)


def opposing(gap, *, n=90, theta=0.0, equality=False):
    """J₂ = −J₁ up to θ, and bounds that miss each other by `gap`; two more rows."""
    rng = np.random.default_rng(11)
    J = rng.standard_normal((4, n))
    J[1] = -2.0 * J[0] + theta * J[1]
    return DirectionProblem(rng.standard_normal(n), J, [1.0, -2.0 + 2.0 * gap, 0.3, -1.0], equality)


@pytest.mark.parametrize("equality", [False, True])
@pytest.mark.parametrize("gap", [1.0, 1e-2, 1e-4])
def test_infeasible_problems_are_so_in_the_span_with_proof_and_least_violation(gap, equality):
    problem = opposing(gap, equality=equality)
    inside, outside = both(problem)
    assert inside.status == outside.status == Status.INFEASIBLE
    assert inside.rung == "pairs"
    assert farkas_residual(problem, inside.multipliers) <= 1e-9
    assert excess_violation(problem, inside.value) <= violation_tolerance(ACTIVE_SET.tolerance, problem.m)
    assert distance(problem, inside, outside) <= 1e-10


def test_a_zero_row_that_asks_for_something_is_infeasible_in_the_span_too():
    J = np.random.default_rng(0).standard_normal((2, 60))
    J[1] = 0.0
    problem = DirectionProblem(np.ones(60), J, [0.0, 1.0])
    inside, outside = both(problem)
    assert inside.status == outside.status == Status.INFEASIBLE
    assert farkas_residual(problem, inside.multipliers) == 0.0
    assert distance(problem, inside, outside) <= 1e-13


@pytest.mark.parametrize(
    "family", [family for family in HOSTILE if family.geometry is None], ids=lambda each: each.name
)
def test_on_hostile_families_both_ways_claim_the_same(family):
    @settings(max_examples=4 * EXAMPLES, derandomize=True, database=None)
    @given(family.problems(tuple(case for case in ALL_CASES if case in family.cases)))
    def check(problem):
        inside, outside = both(repeated(problem))
        claims = {Status.OPTIMAL, Status.INFEASIBLE}
        assert len({inside.status, outside.status} & claims) < 2  # where float64 decides, one may decline
        if inside.status == outside.status and inside.status in claims:
            assert distance(repeated(problem), inside, outside) <= 1e-9

    check()


LAWS_OF_SOLVING = (
    *("check_claims_are_certified", "check_agreement_with_enumeration", "check_permutation", "check_row_scaling"),
    *("check_scaling", "check_duplicate_row", "check_inactive_row", "check_feasible_is_not_called_infeasible"),
    *("check_infeasible_is_called_infeasible", "check_least_violation", "check_input_is_unchanged"),
    *("check_answers_repeat", "check_answers_stay", "check_batch_is_loop", "check_non_finite_is_refused"),
)


def test_the_default_solver_passes_the_kit_in_the_span():
    """Of the kit's shapes (200, 3), (9, 1) and the like are long here."""
    examples = 1000 if IS_NIGHTLY else 12
    check_direction_solver(ACTIVE_SET, checks=LAWS_OF_SOLVING, max_examples=examples, seed=2).raise_for_failures()


WIDE = np.random.default_rng(3).standard_normal((8, 300))
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
@pytest.mark.parametrize("columns", [300, 12_487, 12_488, 12_489, 30_000])
def test_storage_of_any_strides_gives_the_answer_of_a_contiguous_copy(storage, columns):
    """The compiled passes copy 12 488 columns at a time where they have to, of four vectors."""
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
        assert distance(problem, answer, plain) <= 1e-14
        assert answer.multipliers == pytest.approx(plain.multipliers, rel=1e-12, abs=1e-14)
        assert not np.shares_memory(answer.value, g)
    assert (g == before[0]).all()
    assert (before[1] == J).all()


@pytest.mark.parametrize("storage", STORED)
def test_storage_of_any_strides_is_read_in_pairs_and_by_the_referee_too(storage):
    g, J = STORED[storage](np.vstack(at_angle(1e-6, n=9000)))
    problem = DirectionProblem(g, J)
    answer = ACTIVE_SET.solve(problem)
    assert answer.rung == "pairs"
    plain = ACTIVE_SET.solve(DirectionProblem(g.copy(), np.array(J, order="C")))
    assert distance(problem, answer, plain) <= 1e-14
    found = kkt_residuals(problem, answer)
    with on_rows():
        assert found.worst == pytest.approx(kkt_residuals(DirectionProblem(g, J), answer).worst, abs=1e-14)


def test_rows_as_a_list_and_single_precision_give_the_answer_of_an_array_in_double():
    single = WIDE[:4].astype(np.float32)
    V = single.astype(np.float64)
    plain = ACTIVE_SET.solve(DirectionProblem(V[0], V[1:]))
    for given_ in ((single[0], single[1:]), (V[0], list(V[1:])), (V[0].tolist(), V[1:].tolist())):
        assert distance(DirectionProblem(V[0], V[1:]), ACTIVE_SET.solve(DirectionProblem(*given_)), plain) <= 1e-15


def test_short_problems_are_copied_as_before():
    with on_rows():
        problem = DirectionProblem(WIDE[0], WIDE[1:4])
        assert not np.shares_memory(problem.jacobian, WIDE)
    few = WIDE[:, :16]
    assert not np.shares_memory(DirectionProblem(few[0], few[1:4]).jacobian, WIDE)  # n = 4 (1 + m)


def some_answers(problem):
    """Right, wrong in each way, with multipliers that all but cancel, and not finite."""
    right = ACTIVE_SET.solve(problem)
    d, mu = right.value, right.multipliers
    yield d, mu
    yield d + 1e-6 * problem.gradient, mu
    yield d, mu + 1e-6
    yield d, -mu - 1.0
    yield d, mu - (np.arange(len(mu)) == 1)
    yield np.zeros_like(d), np.zeros_like(mu)
    yield 1e160 * d, mu
    for size in (1e3, 1e9, 1e11, 1e15):
        yield d, mu + size * (np.arange(len(mu)) == 0)
        yield d + size * problem.jacobian[0] + problem.gradient, mu + size * (np.arange(len(mu)) == 0)
    for bad in (np.nan, np.inf):
        yield np.where(np.arange(len(d)) == 5, bad, d), mu
        yield d, np.where(np.arange(len(mu)) == 1, bad, mu)


PROBLEMS_TO_JUDGE = {
    "generic": lambda: random_problem(0, equality=[True, False, False, False]),
    "off": lambda: DirectionProblem(WIDE[0], WIDE[1:4], [0.3, -np.inf, -1.0]),
    "zero rows": lambda: DirectionProblem(WIDE[0], WIDE[1:4] * [[1.0], [0.0], [1.0]], [0.3, -1.0, 0.0]),
    "zero row that asks": lambda: DirectionProblem(WIDE[0], WIDE[1:4] * [[1.0], [0.0], [1.0]], [0.3, 1.0, 0.0]),
    "zero row that is off": lambda: DirectionProblem(WIDE[0], WIDE[1:4] * [[0.0], [1.0], [1.0]], [-np.inf, 1.0, 0.0]),
    "zero gradient": lambda: DirectionProblem(0 * WIDE[0], WIDE[1:4]),
    "row scales": lambda: DirectionProblem(WIDE[0], WIDE[1:4] * [[1e100], [1e-100], [1.0]], [1e100, 0.0, -1.0]),
    "beyond squares": lambda: DirectionProblem(WIDE[0], WIDE[1:4] * [[1e170], [1e-170], [1.0]], [1e170, 0.0, -1.0]),
    "small": lambda: DirectionProblem(1e-170 * WIDE[0], WIDE[1:4]),
    "opposing": lambda: DirectionProblem(WIDE[0], [WIDE[1], -WIDE[1], WIDE[2]]),
}


@pytest.mark.parametrize("name", PROBLEMS_TO_JUDGE)
def test_the_referee_says_the_same_of_long_problems_as_on_the_rows(name):
    problem = PROBLEMS_TO_JUDGE[name]()
    assert array_vectors.is_long(problem.m, problem.n)
    for d, mu in some_answers(problem):
        answer = Direction(d, mu, Status.OPTIMAL)
        found = kkt_residuals(problem, answer)
        with on_rows():
            expected = kkt_residuals(DirectionProblem(*arrays(problem)), answer)
        for part in ("stationarity", "primal", "dual", "complementarity"):
            assert getattr(found, part) == pytest.approx(getattr(expected, part), rel=1e-6, abs=2e-14), (part, mu)


def test_a_long_problem_survives_pickling_read_only():
    problem = random_problem(1)
    again = pickle.loads(pickle.dumps(problem))
    for mine, its in zip(arrays(problem), arrays(again), strict=True):
        assert (mine == its).all()
        assert not its.flags.writeable
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
    assert distance(fresh, answer, right) <= 1e-13


def test_arrays_that_change_under_a_problem_do_not_stay_infeasible():
    problem = opposing(1.0)
    V = np.vstack([problem.gradient, problem.jacobian])
    problem = DirectionProblem(V[0], V[1:], problem.bound)
    assert ACTIVE_SET.solve(problem).status == Status.INFEASIBLE
    V[2] = WIDE[7, :90]
    assert ACTIVE_SET.solve(problem).status == Status.OPTIMAL


def test_arrays_put_in_the_place_of_a_problems_own_are_the_ones_looked_at():
    problem = random_problem(2)
    object.__setattr__(problem, "gradient", np.where(np.arange(problem.n) == 3, np.nan, problem.gradient))
    assert ACTIVE_SET.solve(problem).status not in (Status.OPTIMAL, Status.INFEASIBLE)


def test_a_batch_of_long_problems_is_its_problems():
    problems = [random_problem(seed) for seed in range(3)]
    for name in EVERY_SOLVER:
        if supports(SOLVERS[name], problems[0]):
            answers = SOLVERS[name].solve_batch(ProblemBatch.stack(problems))
            for problem, answer in zip(problems, answers, strict=True):
                assert answer.status == Status.OPTIMAL
                assert distance(problem, answer, SOLVERS[name].solve(problem)) <= 1e-12


@pytest.mark.parametrize("name", ["osqp", "cvxpy"])
def test_sessions_take_long_problems(name):
    """OSQP's refused them: they come in coordinates, of another shape than the session's."""
    solver = SOLVERS[name]
    if not is_usable(solver):
        pytest.skip(f"{name} is not installed")
    problem, hard = random_problem(4), DirectionProblem(*at_angle(1e-10), [0.3, -0.3, 0.1], True)
    assert distance(problem, solver.session(80, 4).solve(problem), ACTIVE_SET.solve(problem)) <= 1e-7
    assert solver.session(120, 3).solve(hard).status in Status  # no rung takes it
    with pytest.raises(ValueError, match="problem should have m = 4"):
        solver.session(80, 4).solve(random_problem(0, m=3))
