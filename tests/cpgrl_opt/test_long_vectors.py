"""The ladder's laws: what is solved in the coordinates of the span is what is solved on the rows, or exact rationals.

LEAST_PRODUCTS = 0 sends every problem with n > 4 (1 + m) through the ladder, a huge one none.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given, settings

from cpgrl_opt import SOLVERS, DirectionProblem, Status
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


def test_a_batch_of_long_problems_is_its_problems():
    problems = [random_problem(seed) for seed in range(3)]
    for name in EVERY_SOLVER:
        if supports(SOLVERS[name], problems[0]):
            answers = SOLVERS[name].solve_batch(ProblemBatch.stack(problems))
            for problem, answer in zip(problems, answers, strict=True):
                assert answer.status == Status.OPTIMAL
                assert distance(problem, answer, SOLVERS[name].solve(problem)) <= 1e-12


def test_sessions_take_long_problems():
    """OSQP's refused them: they come in coordinates, of another shape than the session's."""
    solver = SOLVERS["osqp"]
    if not is_usable(solver):
        pytest.skip("osqp is not installed")
    problem, hard = random_problem(4), opposing(0.0, n=120, theta=1e-10, equality=True)
    assert distance(problem, solver.session(80, 4).solve(problem), ACTIVE_SET.solve(problem)) <= 1e-7
    assert solver.session(120, 4).solve(hard).status in Status  # no rung takes it
    with pytest.raises(ValueError, match="problem should have m = 4"):
        solver.session(80, 4).solve(random_problem(0, m=3))
