"""What is right passes, with few problems too; what a solver says of itself gets it out of nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status
from cpgrl_opt.solvers import tolerance_of
from cpgrl_opt.testing import FunctionSolver, LawBroken, Outcome, check_direction_solver, check_stationarity
from cpgrl_opt.testing.law import is_held_in_single, takes
from cpgrl_opt.testing.verdict import CheckResult, Verdict

ACTIVE_SET = SOLVERS["active-set"]
LAWS_AT_HAND = ["check_stationarity", "check_infeasible_is_called_infeasible", "check_least_violation"]


@pytest.fixture(autouse=True)
def little_shrinking(monkeypatch):
    monkeypatch.setattr("cpgrl_opt.testing.examination._SHRINKING_CALLS", 12)


def with_status(problem, status):
    return Direction(np.zeros(problem.n), np.zeros(problem.m), status)


def single(problem):
    """The projection for numbers rounded to float32, rounded again."""
    names = ("gradient", "jacobian", "bound")
    with np.errstate(over="ignore"):
        rounded = [getattr(problem, name).astype(np.float32) for name in names]
    if np.isinf(rounded[2][problem.bound > -np.inf]).any():
        return SimpleNamespace(value=np.zeros(problem.n), multipliers=np.zeros(problem.m), status=Status.UNSUPPORTED)
    answer = ACTIVE_SET.solve(DirectionProblem(*rounded, problem.equality))
    value, multipliers = (part.astype(np.float32) for part in (answer.value, answer.multipliers))
    return SimpleNamespace(value=value, multipliers=multipliers, status=answer.status)


def half_space(g, J, b):
    (a,), (bound,) = J, b
    squares = a @ a
    if not squares:
        return g if bound <= 0 else None
    return g + max(bound - a @ g, 0.0) / squares * a


def test_a_function_for_one_row_that_says_so_passes_and_one_that_does_not_is_told_how():
    silent = check_direction_solver(FunctionSolver(half_space), checks=["check_stationarity"], max_examples=8)
    assert "half_space.supports = lambda problem: …" in silent["check_stationarity"].problem
    half_space.supports, half_space.finds_infeasible = lambda problem: problem.m == 1, False
    try:
        verdict = check_direction_solver(FunctionSolver(half_space), checks=LAWS_AT_HAND, max_examples=8)
    finally:
        del half_space.supports, half_space.finds_infeasible
    verdict.raise_for_failures()
    assert verdict["check_stationarity"].run > 0


@pytest.mark.parametrize("said", [{}, {"dtype": "float32"}])
def test_a_solver_in_float32_is_judged_on_what_float32_holds(said):
    solver = SimpleNamespace(solve=single, **said)
    checks = ["check_stationarity", "check_agreement_with_enumeration", "check_primal_feasibility"]
    verdict = check_direction_solver(solver, checks=checks, max_examples=15)
    verdict.raise_for_failures()
    assert all(result.run > 0 for result in verdict.results)
    wrong = SimpleNamespace(solve=lambda problem: ACTIVE_SET.solve(problem), **said)
    wrong.solve = lambda problem: SimpleNamespace(**{**vars(single(problem)), "value": np.ones(problem.n, np.float32)})
    assert not check_direction_solver(wrong, checks=checks[:1], max_examples=8).passed


@pytest.mark.parametrize(
    ("numbers", "held"), [([1.0, -3.0], True), ([0.1, 1.0], False), ([1e-100, 1.0], False), ([1e100, 1.0], False)]
)
def test_which_problems_float32_holds(numbers, held):
    problem = DirectionProblem(numbers, [[1.0, 0.0]], [-np.inf])
    assert is_held_in_single(problem) == held
    solver = SimpleNamespace(solve=single, dtype=np.float32)
    assert takes(solver, problem) == held
    assert tolerance_of(SimpleNamespace(solve=single, dtype=np.dtype("float32"), tolerance=1e-9)) == 4 * 2.0**-23


def uncertain(problem):
    """Right, and never says INFEASIBLE."""
    answer = ACTIVE_SET.solve(problem)
    return answer if answer.status == Status.OPTIMAL else with_status(problem, Status.UNCERTIFIED)


def test_a_solver_that_cannot_tell_what_is_infeasible_may_say_so_once_and_for_all():
    honest = SimpleNamespace(solve=uncertain, finds_infeasible=False)
    check_direction_solver(honest, checks=LAWS_AT_HAND, max_examples=6).raise_for_failures()
    told = check_direction_solver(SimpleNamespace(solve=uncertain), checks=LAWS_AT_HAND[1:2], max_examples=6)
    assert "let the solver say `finds_infeasible = False`" in told.results[0].problem
    assert "supports" not in told.results[0].problem
    liar = SimpleNamespace(
        solve=lambda problem: Direction(ACTIVE_SET.solve(problem).value, np.zeros(problem.m), Status.OPTIMAL),
        finds_infeasible=False,
    )
    assert not check_direction_solver(liar, checks=LAWS_AT_HAND[1:2], max_examples=6).passed
    silent = SimpleNamespace(solve=lambda problem: with_status(problem, Status.UNCERTIFIED), finds_infeasible=False)
    assert not check_direction_solver(silent, checks=LAWS_AT_HAND, max_examples=6).passed


@pytest.mark.parametrize("max_examples", [1, 3])
def test_right_solvers_pass_with_few_problems_and_one_that_never_answers_does_not(max_examples):
    """Laws that say nothing about the few that were drawn failed them; so did two declines of two."""
    checks = ["check_inactive_row", "check_stationarity", "check_scaling", "check_rotation", "check_idempotence"]
    seen = []

    def mostly(problem):
        seen.append(problem)
        return with_status(problem, Status.ITERATION_LIMIT) if len(seen) <= 2 else ACTIVE_SET.solve(problem)

    for right in (ACTIVE_SET, SimpleNamespace(solve=mostly)):
        check_direction_solver(right, checks=checks, max_examples=max_examples).raise_for_failures()
    never = SimpleNamespace(solve=lambda problem: with_status(problem, Status.UNCERTIFIED))
    verdict = check_direction_solver(never, checks=checks, max_examples=max_examples)
    assert not verdict.passed
    assert "claimed nothing of any of" in verdict.summary


def test_declines_are_counted_over_all_laws():
    """3 of 10 in a law may be chance, in each of twenty laws it is not."""
    names = ["check_stationarity", "check_scaling", "check_rotation", "check_permutation", "check_symmetry"]
    results = tuple(CheckResult(name, "", run=10, declined=3) for name in names)
    assert not Verdict("some", 1e-6, 10, 0, results).passed
    assert Verdict("some", 1e-6, 10, 0, results[:1]).passed


def unequal(problem):
    """Takes no equality, and says so only in its answer."""
    return with_status(problem, Status.UNSUPPORTED) if problem.equality.any() else ACTIVE_SET.solve(problem)


def convenient(problem):
    """Calls UNSUPPORTED what is hard for it."""
    is_hard = np.linalg.matrix_rank(problem.jacobian) < min(problem.jacobian.shape) or problem.bound.any()
    return (
        with_status(problem, Status.UNSUPPORTED) if is_hard and problem.gradient[0] > 0 else ACTIVE_SET.solve(problem)
    )


def test_what_is_called_unsupported_is_skipped_where_that_is_a_limit_and_else_declined():
    checks = ["check_stationarity", "check_scaling"]
    limited = check_direction_solver(SimpleNamespace(solve=unequal), checks=checks, max_examples=30)
    limited.raise_for_failures()
    assert all(result.skipped > 0 and result.declined == 0 for result in limited.results)
    assert not check_direction_solver(SimpleNamespace(solve=convenient), checks=checks, max_examples=30).passed
    problem = DirectionProblem([1.0, 0.0], [[0.0, 1.0]], equality=True)
    assert check_stationarity(SimpleNamespace(solve=unequal), problem) == Outcome.UNSUPPORTED


def test_a_supports_or_a_tolerance_that_wavers_is_refused():
    asked = []

    def wavers(_):
        asked.append(True)
        return len(asked) % 3 != 0

    fickle = SimpleNamespace(solve=ACTIVE_SET.solve, supports=wavers)
    verdict = check_direction_solver(fickle, checks=["check_stationarity"], max_examples=6)
    assert "supports should say the same of one problem each time" in verdict.results[0].problem

    class Elastic:
        tolerances = iter([1e-6] * 4 + [1e-3] * 10_000)

        @property
        def tolerance(self):
            return next(self.tolerances)

        def solve(self, problem):
            return ACTIVE_SET.solve(problem)

    verdict = check_direction_solver(Elastic(), checks=["check_stationarity"], max_examples=6)
    assert "tolerance should be one number; found" in verdict.results[0].problem
    with pytest.raises(LawBroken):
        verdict.raise_for_failures()


@pytest.mark.parametrize("shape", [(17, None), (None, 11)])
def test_a_solver_of_one_shape_that_is_seldom_drawn_is_put_to_the_laws(shape):
    """Of n = 7 alone no example was asked about, and one problem in 360 drawn: "takes none"."""

    def supports(problem):
        return all(want in (None, found) for want, found in zip(shape, (problem.n, problem.m), strict=True))

    right = SimpleNamespace(solve=ACTIVE_SET.solve, supports=supports)
    wrong = SimpleNamespace(
        solve=lambda problem: Direction(-problem.gradient, np.zeros(problem.m), Status.OPTIMAL), supports=supports
    )
    checks = ("check_stationarity", "check_infeasible_is_called_infeasible")
    verdict = check_direction_solver(right, checks=checks, max_examples=8)
    assert verdict.passed
    assert all(result.run >= 4 for result in verdict.results)
    assert not check_direction_solver(wrong, checks=checks[:1], max_examples=8).passed
