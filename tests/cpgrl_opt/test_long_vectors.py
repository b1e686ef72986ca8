"""The ladder's laws: what is solved in the coordinates of the span is what is solved on the rows."""

import math

import numpy as np
import pytest
from hypothesis import given, settings

from cpgrl_opt import SOLVERS, ConstrainedStep, Direction, DirectionProblem, Linearization, Status, kkt_residuals
from cpgrl_opt.certify import excess_violation, farkas_residual, violation_tolerance
from cpgrl_opt.scaling import lengths
from cpgrl_opt.solvers import is_usable, span, supports
from cpgrl_opt.testing.strategies import HOSTILE, WELL_POSED, problems_of
from cpgrl_opt.vectors import is_long

from .long import distance, drawn_problem, least_products, on_rows

pytestmark = pytest.mark.usefixtures("every_problem_is_long")
ACTIVE_SET = SOLVERS["active-set"]
IS_NIGHTLY = settings().max_examples >= 1000
EXAMPLES = settings().max_examples if IS_NIGHTLY else 3  # a family and a solver
OFTEN = ("active-set", "nnls", "quadprog", "osqp", "rosen")
EVERY_SOLVER = [name for name, solver in SOLVERS.items() if (IS_NIGHTLY or name in OFTEN) and is_usable(solver)]
# Those that end at an optimum, rather than near one.
EXACT_SOLVERS = ("active-set", "nnls", "enumeration", "rosen")
CLAIMS = {Status.OPTIMAL, Status.INFEASIBLE}


def solve_both_ways(problem, solver=ACTIVE_SET):
    """The answers in the span and on the rows."""
    arrays = problem.gradient, problem.jacobian, problem.bound, problem.equality
    inside = solver.solve(DirectionProblem(*arrays))
    with on_rows():
        return inside, solver.solve(DirectionProblem(*arrays))


def repeat(problem):
    """(g g …), (J J …) and r b, r a power of two that makes it long: every inner product is r times what it was."""
    times = max(1, 2 ** math.ceil(math.log2((4 * (1 + problem.m) + 1) / problem.n) + 1))
    g, J = np.tile(problem.gradient, times), np.tile(problem.jacobian, (1, times))
    return DirectionProblem(g, J, times * problem.bound, problem.equality)


def active_set(problem, answer):
    """Rows with μ̂ > 1e-8 σ, where multipliers are unique; None where the rows that bind depend on each other."""
    units = np.where(problem.jacobian.any(axis=1), lengths(problem.jacobian), 1.0)
    sigma = max(float(lengths(problem.gradient)), float(lengths(answer.value))) or 1.0
    binding = np.abs(problem.jacobian @ answer.value - problem.bound) <= 1e-8 * units * sigma
    rows = problem.jacobian[binding] / units[binding, None]
    if len(rows) and np.linalg.svd(rows, compute_uv=False)[-1] < 1e-4:
        return None
    return np.flatnonzero(np.abs(answer.multipliers) * units > 1e-8 * sigma).tolist()


def require_same(problem, name, is_hostile):
    inside, outside = solve_both_ways(problem, SOLVERS[name])
    claimed = {inside.status, outside.status} & CLAIMS
    assert len(claimed) < 2  # where float64 decides, one may decline
    if not is_hostile and name in EXACT_SOLVERS:
        assert inside.status == outside.status
    if inside.status == outside.status and claimed:
        assert distance(problem, inside, outside) <= (1e-9 if is_hostile else 1e-12 if name == "active-set" else 1e-10)
        if not is_hostile and inside.status == Status.OPTIMAL:
            assert active_set(problem, inside) == active_set(problem, outside)


@pytest.mark.parametrize(
    "family", [each for each in (*WELL_POSED, *HOSTILE) if each.geometry is None], ids=lambda family: family.name
)
def test_every_solver_claims_in_the_span_what_it_claims_on_the_rows(family):
    is_hostile = family in HOSTILE

    @settings(max_examples=(2 if is_hostile else 1) * EXAMPLES, derandomize=True, database=None)
    @given(problems_of(family))
    def check(problem):
        for name in ("active-set",) if is_hostile else EVERY_SOLVER:
            if supports(SOLVERS[name], problem):
                require_same(repeat(problem), name, is_hostile)

    check()


@pytest.mark.parametrize("rungs", [("pairs",), ()], ids=["pairs", "rows"])
def test_a_rung_that_is_forced_where_it_is_not_needed_agrees(monkeypatch, rungs):
    for seed in range(20):
        problem = drawn_problem(seed, equality=[seed % 3 == 0, False, False, False])
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


ZERO_ROW = DirectionProblem(np.ones(60), np.vstack([np.arange(60.0), np.zeros(60)]), [0.0, 1.0])


@pytest.mark.parametrize(
    ("problem", "rung"),
    [
        *((opposing(gap, equality=equality), "pairs") for gap in (1.0, 1e-2, 1e-4) for equality in (False, True)),
        (ZERO_ROW, None),
    ],
)
def test_infeasible_problems_are_so_in_the_span_with_proof_and_least_violation(problem, rung):
    inside, outside = solve_both_ways(problem)
    assert inside.status == outside.status == Status.INFEASIBLE
    assert rung is None or inside.rung == rung
    assert farkas_residual(problem, inside.multipliers) <= 1e-9
    assert rung is None or excess_violation(problem, inside.value) <= violation_tolerance(1e-9, problem.m)
    assert distance(problem, inside, outside) <= 1e-10


def test_sessions_take_long_problems():
    """OSQP's refused them: they come in coordinates, of another shape than the session's."""
    solver = SOLVERS["osqp"]
    problem, hard = drawn_problem(4), opposing(0.0, n=120, theta=1e-10, equality=True)
    assert distance(problem, solver.session(80, 4).solve(problem), ACTIVE_SET.solve(problem)) <= 1e-7
    assert solver.session(120, 4).solve(hard).status in Status  # no rung takes it
    with pytest.raises(ValueError, match="problem should have m = 4"):
        solver.session(80, 4).solve(drawn_problem(0, m=3))


def in_few_and_many(seed, n=2000):
    """A problem of 8 parameters, dependent or with g in the span of −J at times; and in 8 orthonormal vectors of n."""
    rng = np.random.default_rng(seed)
    g, J = rng.standard_normal(8), rng.standard_normal((3, 8))
    if seed % 4 == 1:
        J[1] = -J[0]
    if seed % 4 == 2:
        g = -J.T @ rng.random(3)
    bound = 0.3 * rng.standard_normal(3) * (seed % 3 > 0)
    basis = np.linalg.qr(rng.standard_normal((n, 8)))[0].T
    return (g, J, bound), (g @ basis, J @ basis, bound), basis


@pytest.mark.parametrize("sizes", [None, 2.0 ** np.random.default_rng(5).uniform(-1.0, 1.0, 2000)], ids=["", "metric"])
@pytest.mark.parametrize("radius", [None, 1e-3, 0.5, 1e12])
@pytest.mark.parametrize("seed", range(8))
def test_a_ball_or_a_diagonal_metric_in_many_parameters_is_that_in_few(seed, radius, sizes):
    (g, J, bound), many, basis = in_few_and_many(seed)
    units = 1.0 if sizes is None else sizes
    expected = ACTIVE_SET.solve(DirectionProblem(g, J, bound, radius=radius))
    metric = None if sizes is None else sizes**2
    problem = DirectionProblem(many[0] * units, many[1] * units, bound, metric=metric, radius=radius)
    answer = ACTIVE_SET.solve(problem)
    assert answer.status == expected.status
    size = max(float(np.linalg.norm(expected.value)), 1.0)
    np.testing.assert_allclose(answer.value * units, expected.value @ basis, atol=1e-9 * size)
    if answer.status == Status.OPTIMAL:
        assert seed % 4 in (1, 2) or radius == 1e12 or answer.rung == "gramian"
        assert kkt_residuals(problem, answer).worst <= 1e-9
        assert answer.residuals is not None
        assert answer.radius_multiplier == pytest.approx(expected.radius_multiplier, rel=1e-7, abs=1e-12)


@pytest.mark.parametrize("kappa", [0.0, 0.4, -0.2])
def test_the_referee_sees_in_passes_what_it_sees_in_few_parameters(kappa):
    few, many, basis = in_few_and_many(5)
    rng = np.random.default_rng(3)
    d, mu = rng.standard_normal(8), rng.standard_normal(3)
    expected, found = (
        kkt_residuals(DirectionProblem(*each, radius=0.7), Direction(value, mu, Status.OPTIMAL, 0, kappa))
        for each, value in ((few, d), (many, d @ basis))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


E = np.eye(20)


@pytest.mark.parametrize(
    ("gradient", "rows", "bound", "right"),
    [
        (E[0], [1e301 * E[0], E[0]], [-np.inf, 0.5], E[0]),
        (1e10 * (E[0] - E[1]), [1e300 * E[0], E[1]], [-np.inf, 0.0], 1e10 * E[0]),
        (E[0], [E[0] + E[1], E[0]], [-np.inf, 0.5], E[0]),
        (1e-10 * E[0], [E[0]], [1e300], 1e300 * E[0]),
        (E[0], [E[0]], [1e305], 1e305 * E[0]),
    ],
)
@pytest.mark.parametrize("errors", ["warn", "raise"])
def test_rows_that_are_off_and_huge_numbers_cost_no_answer_and_no_warning(gradient, rows, bound, right, errors):
    with np.errstate(all=errors):
        answer = ACTIVE_SET.solve(DirectionProblem(gradient, np.array(rows), bound))
    assert answer.status == Status.OPTIMAL
    np.testing.assert_allclose(answer.value, right, rtol=1e-12, atol=0)


def test_whether_nothing_is_left_of_the_gradient_is_told_alike_in_the_span_and_on_the_rows():
    """PΔ¹ is 1e-9 long in ten thousand parts of 1e-11: no rotation may decide whether that is 0."""
    n = 10_000
    spread = np.full(n, 1.0 / np.sqrt(n - 1))
    spread[0] = 0.0
    gradients = np.array([np.eye(1, n)[0] + 1e-9 * spread, np.eye(1, n)[0]])
    results = []
    for products in (0, 10**18):
        with least_products(products):
            results.append(ConstrainedStep()(Linearization([0.0, 0.0], gradients), [0.1]))
    assert results[0].counts["dropped"] == results[1].counts["dropped"] == 0
    np.testing.assert_allclose(results[0].change, results[1].change, atol=1e-15)


def test_the_rows_are_named_where_no_rung_answers():
    problem = DirectionProblem(E[0] + E[2], [E[0], -E[0] + 1e-11 * E[1]], equality=True)
    assert {SOLVERS[name].solve(problem).rung for name in ("active-set", "nnls")} == {"rows"}


@pytest.mark.parametrize(
    ("m", "n", "is_it"),
    [
        *((1, 49_999, False), (1, 50_000, True), (5, 16_666, False), (5, 16_667, True), (50, 384, False)),
        *((50, 385, True), (5000, 20_004, False), (5000, 20_005, True)),  # never with nearly as many rows
    ],
)
def test_a_problem_is_long_where_it_is_solved_faster_in_coordinates(m, n, is_it):
    with least_products(10**6):
        assert is_long(m, n) == is_it
