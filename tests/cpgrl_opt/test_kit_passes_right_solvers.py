"""What is right passes, with few problems too; what a solver says of itself gets it out of nothing."""

import contextlib
import io
import os
import sys
import threading
import time
import warnings
from dataclasses import dataclass, replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status, kkt_residuals
from cpgrl_opt.published import CPO
from cpgrl_opt.solvers import tolerance_of
from cpgrl_opt.testing import (
    Case,
    FunctionSolver,
    LawError,
    Outcome,
    check_answers_stay,
    check_direction_solver,
    check_global_state_is_unchanged,
    check_stationarity,
    check_threads_do_not_meet,
    check_time_is_in_proportion,
    supported_cases,
)
from cpgrl_opt.testing.law import is_held_in_single, takes
from cpgrl_opt.testing.strategies import ALL_CASES
from cpgrl_opt.testing.verdict import CheckResult, Verdict

from .bad_solvers import CORRECT, GEOMETRY, Faulty, balls, in_batches, metrics, one_row

LAWS_AT_HAND = ["check_stationarity", "check_infeasible_is_called_infeasible", "check_least_violation"]
PROBLEM = DirectionProblem([1.0, -1.0], [[-1.0, 0.0]])
OTHER = DirectionProblem([2.0, 5.0], [[-1.0, 0.0]])


@pytest.fixture(autouse=True)
def little_shrinking(monkeypatch):
    monkeypatch.setattr("cpgrl_opt.testing.examination._SHRINKING_CALLS", 12)


def verdict_on(solve, checks, max_examples, **more):
    return check_direction_solver(SimpleNamespace(solve=solve, **more), checks=checks, max_examples=max_examples)


def face_projection(g, rows, bound):
    """(d, μ) of the projection onto rows d = bound, by a pseudo-inverse."""
    inverse = np.linalg.pinv(rows, rcond=1e-12)
    d = g + inverse @ (bound - rows @ g)
    d = d + inverse @ (bound - rows @ d)
    return d, inverse.T @ (d - g)


def nearest(g, rows, bound, equality):
    """(d, μ, error) of the best active set."""
    best = (g, np.zeros(len(bound)), np.inf)
    always, optional = np.flatnonzero(equality), np.flatnonzero(~equality)
    for size in range(len(optional) + 1):
        for more in combinations(optional, size):
            face = np.array([*always, *more], dtype=int)
            mu = np.zeros(len(bound))
            d, mu[face] = face_projection(g, rows[face], bound[face])
            lack = bound - rows @ d
            error = max(np.where(equality, np.abs(lack), np.maximum(lack, -mu)).max(initial=0.0), 0.0)
            if error < best[2]:
                best = d, mu, error
            if error < 1e-13:
                return best
    return best


@dataclass(frozen=True)
class ByHand:
    """Every active set in plain NumPy on unit rows, of few rows; declares no tolerance."""

    def supports(self, problem):
        return problem.m <= 6

    def solve(self, problem):
        lengths = np.linalg.norm(problem.jacobian, axis=1)
        if not (np.isfinite(problem.gradient).all() and np.isfinite(lengths).all() and (problem.bound < np.inf).all()):
            raise ValueError("found what is not finite")
        on = (problem.bound > -np.inf) & (lengths > 0)
        impossible = (lengths == 0) & ((problem.bound > 0) | (problem.equality & (problem.bound != 0)))
        rows, bound = problem.jacobian[on] / lengths[on, None], problem.bound[on] / lengths[on]
        equality = problem.equality[on]
        scale = max([np.linalg.norm(problem.gradient), *np.where(equality, np.abs(bound), bound)]) or 1.0
        g, bound = problem.gradient / scale, bound / scale
        d, weights, error = nearest(g, rows, bound, equality)
        mu = np.zeros(problem.m)
        mu[on] = weights * scale / lengths[on]
        answer = Direction(d * scale, mu, Status.OPTIMAL)
        if not impossible.any() and error < 1e-9 and kkt_residuals(problem, answer).worst <= 1e-6:
            return answer
        # min ‖y − b‖ s.t. Jᵀy = 0, y ≥ 0 on I is both the least violation and Farkas' vector.
        sides = np.vstack([np.eye(len(bound))[~equality], rows.T])
        y, _, _ = nearest(bound, sides, np.zeros(len(sides)), np.arange(len(sides)) >= (~equality).sum())
        proof = np.zeros(problem.m)
        proof[on] = y / lengths[on]
        if impossible.any():
            proof = np.where(impossible, np.sign(problem.bound), 0.0)
        status = Status.INFEASIBLE if impossible.any() or np.linalg.norm(y) > 1e-4 else Status.UNCERTIFIED
        return Direction(nearest(g, rows, bound - y, equality)[0] * scale, proof, status)


CONSTRAINTS = {Case.CONE, Case.BOUNDS, Case.TANGENT, Case.AFFINE}
ABOUT_MANY = {"batch_is_loop", "neighbours_change_nothing", "warm_start_is_cold_start"}
ABOUT_ROWS = {"permutation", "duplicate_row", "inactive_row"}
PROJECTIONS = {"gradient_kept_when_feasible", "idempotence", "non_expansiveness", "symmetry"}
PROJECTIONS |= {"firm_non_expansiveness", "restoration_is_normal"}
# What each takes, and the laws that say nothing about it.
RIGHT = {
    "by hand": (ByHand(), set(ALL_CASES), ABOUT_MANY),
    "one row": (
        Faulty(supports=one_row), {*CONSTRAINTS, Case.ONE_ROW}, ABOUT_MANY | ABOUT_ROWS | {"least_violation"}
    ),
    "balls": (
        Faulty(supports=balls, **GEOMETRY), {*ALL_CASES, Case.RADIUS, Case.BALL}, ABOUT_MANY | PROJECTIONS
    ),
    "CPO": (
        CPO(), {Case.CONE, Case.BOUNDS, Case.RADIUS, Case.ONE_ROW, Case.BALL}, ABOUT_MANY | ABOUT_ROWS | PROJECTIONS
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RIGHT)
def test_a_right_solver_passes_the_laws_that_speak_about_it(name):
    """And is handed nothing that it does not take: `Faulty` would fail."""
    solver, cases, silent = RIGHT[name]
    assert set(supported_cases(solver)) == cases
    verdict = check_direction_solver(solver, max_examples=3)
    verdict.raise_for_failures()
    assert {result.check for result in verdict.results if not result.supported} == {f"check_{law}" for law in silent}
    assert all(result.run for result in verdict.results if result.supported)


def test_only_who_declares_geometry_is_asked_for_it():
    def solve(problem):
        assert metrics(problem)
        assert problem.metric is None
        return CORRECT.solve(problem)

    naive = SimpleNamespace(solve=solve, supports=lambda problem: problem.m < 9)
    assert not any(case.is_geometry for case in supported_cases(naive))
    assert verdict_on(**vars(naive), checks=["check_stationarity", "check_silence"], max_examples=8).passed
    assert set(supported_cases(SOLVERS["rosen"])) == {Case.TANGENT, Case.AFFINE, Case.METRIC, Case.RADIUS}


def test_a_solver_of_one_shape_that_is_seldom_drawn_is_put_to_the_laws():
    """Of n = 17 alone no example was asked about, and one problem in 360 drawn: "takes none"."""
    checks = ["check_stationarity", "check_infeasible_is_called_infeasible"]
    verdict = verdict_on(CORRECT.solve, checks, 4, supports=lambda problem: problem.n == 17)
    assert verdict.passed
    assert all(result.run >= 2 for result in verdict.results)


# What looks like a fault and is none.


def test_answers_that_are_the_problems_own_arrays_or_read_only_are_no_fault():
    def frugal(problem, answer):
        if (answer.value == problem.gradient).all():
            return replace(answer, value=problem.gradient)
        answer.value.flags.writeable = False
        return answer

    assert check_answers_stay(Faulty(frugal), PROBLEM, OTHER) == Outcome.HELD
    assert check_answers_stay(Faulty(frugal), OTHER, PROBLEM) == Outcome.HELD


def test_threads_that_take_turns_are_no_fault():
    turn = threading.Lock()

    def solve(problem):
        with turn, contextlib.redirect_stdout(io.StringIO()):
            return CORRECT.solve(problem)

    streams = (sys.stdin, sys.stdout, sys.stderr)
    assert check_threads_do_not_meet(SimpleNamespace(solve=solve), PROBLEM, OTHER) == Outcome.HELD
    assert (sys.stdin, sys.stdout, sys.stderr) == streams


def test_what_an_import_changes_once_is_no_fault():
    seen = []

    def importing(_, answer):
        if not seen:
            seen.append(True)
            warnings.filterwarnings("ignore", message="of the package that is imported now")
            os.environ["LAWS_TEST_IMPORTED"] = "1"
        return answer

    assert check_global_state_is_unchanged(Faulty(importing), PROBLEM) == Outcome.HELD
    assert "LAWS_TEST_IMPORTED" not in os.environ


def test_a_first_call_that_compiles_and_a_solver_that_is_slow_throughout_are_no_fault():
    known = set()

    def compiling(problem, answer):
        if problem.jacobian.shape not in known:
            known.add(problem.jacobian.shape)
            time.sleep(0.3)
        return answer

    def slow(problem, answer):
        time.sleep(0.12)
        return answer

    assert check_time_is_in_proportion(Faulty(compiling), PROBLEM) == Outcome.HELD
    assert check_time_is_in_proportion(Faulty(slow), PROBLEM) == Outcome.HELD


def test_a_batch_that_is_a_loop_is_no_fault():
    assert check_direction_solver(in_batches(list), checks=["check_batch_is_loop"], max_examples=20).passed


# What a solver says of itself.


def with_status(problem, status):
    return Direction(np.zeros(problem.n), np.zeros(problem.m), status)


def single(problem):
    """The projection for numbers rounded to float32, rounded again."""
    names = ("gradient", "jacobian", "bound")
    with np.errstate(over="ignore"):
        rounded = [getattr(problem, name).astype(np.float32) for name in names]
    if np.isinf(rounded[2][problem.bound > -np.inf]).any():
        return with_status(problem, Status.UNSUPPORTED)
    answer = CORRECT.solve(DirectionProblem(*rounded, problem.equality))
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
    checks = ["check_stationarity", "check_agreement_with_enumeration", "check_primal_feasibility"]
    verdict = verdict_on(single, checks, 15, **said)
    verdict.raise_for_failures()
    assert all(result.run > 0 for result in verdict.results)

    def wrong(problem):
        return SimpleNamespace(**{**vars(single(problem)), "value": np.ones(problem.n, np.float32)})

    assert not verdict_on(wrong, checks[:1], 8, **said).passed


@pytest.mark.parametrize(
    ("numbers", "held"), [([1.0, -3.0], True), ([0.1, 1.0], False), ([1e-100, 1.0], False), ([1e100, 1.0], False)]
)
def test_which_problems_float32_holds(numbers, held):
    problem = DirectionProblem(numbers, [[1.0, 0.0]], [-np.inf])
    assert is_held_in_single(problem) == held
    assert takes(SimpleNamespace(solve=single, dtype=np.float32), problem) == held
    assert tolerance_of(SimpleNamespace(solve=single, dtype=np.dtype("float32"), tolerance=1e-9)) == 4 * 2.0**-23


def test_a_solver_that_cannot_tell_what_is_infeasible_may_say_so_once_and_for_all():
    def uncertain(problem):
        answer = CORRECT.solve(problem)
        return answer if answer.status == Status.OPTIMAL else with_status(problem, Status.UNCERTIFIED)

    verdict_on(uncertain, LAWS_AT_HAND, 6, finds_infeasible=False).raise_for_failures()
    told = verdict_on(uncertain, LAWS_AT_HAND[1:2], 6).results[0].problem
    assert "let the solver say `finds_infeasible = False`" in told
    assert "supports" not in told
    lies = Faulty(lambda _, answer: replace(answer, status=Status.OPTIMAL)).solve
    assert not verdict_on(lies, LAWS_AT_HAND[1:2], 6, finds_infeasible=False).passed
    never = Faulty(lambda problem, _: with_status(problem, Status.UNCERTIFIED)).solve
    assert not verdict_on(never, LAWS_AT_HAND, 6, finds_infeasible=False).passed


@pytest.mark.parametrize("max_examples", [1, 3])
def test_right_solvers_pass_with_few_problems_and_one_that_never_answers_does_not(max_examples):
    """Laws that say nothing about the few that were drawn failed them; so did two declines of two."""
    checks = ["check_inactive_row", "check_stationarity", "check_scaling", "check_rotation", "check_idempotence"]
    seen = []

    def mostly(problem):
        seen.append(problem)
        return with_status(problem, Status.ITERATION_LIMIT) if len(seen) <= 2 else CORRECT.solve(problem)

    for right in (CORRECT.solve, mostly):
        verdict_on(right, checks, max_examples).raise_for_failures()
    verdict = verdict_on(lambda problem: with_status(problem, Status.UNCERTIFIED), checks, max_examples)
    assert not verdict.passed
    assert "claimed nothing of any of" in verdict.summary


@pytest.mark.parametrize(("share", "passed"), [(0.01, True), (0.2, False)])
def test_declining_now_and_then_is_allowed_and_often_is_not(share, passed):
    rng = np.random.default_rng(0)

    def declining(_, answer):
        return replace(answer, status=Status.ITERATION_LIMIT) if rng.random() < share else answer

    verdict = verdict_on(Faulty(declining).solve, ["check_stationarity"], 100)
    assert verdict.passed == passed
    assert passed or "more than 5%" in verdict["check_stationarity"].problem


def test_declines_are_counted_over_all_laws():
    """3 of 10 in a law may be chance, in each of twenty laws it is not."""
    names = ["check_stationarity", "check_scaling", "check_rotation", "check_permutation", "check_symmetry"]
    results = tuple(CheckResult(name, "", run=10, declined=3) for name in names)
    assert not Verdict("some", 1e-6, 10, 0, results).passed
    assert Verdict("some", 1e-6, 10, 0, results[:1]).passed


def test_what_is_called_unsupported_is_skipped_where_that_is_a_limit_and_else_declined():
    """Who takes no equality, and says so only in the answer; and who calls UNSUPPORTED what is hard."""

    def limited(problem):
        return with_status(problem, Status.UNSUPPORTED) if problem.equality.any() else CORRECT.solve(problem)

    def convenient(problem):
        is_hard = np.linalg.matrix_rank(problem.jacobian) < min(problem.jacobian.shape) or problem.bound.any()
        is_declined = is_hard and problem.gradient[0] > 0
        return with_status(problem, Status.UNSUPPORTED) if is_declined else CORRECT.solve(problem)

    checks = ["check_stationarity", "check_scaling"]
    verdict = verdict_on(limited, checks, 30)
    verdict.raise_for_failures()
    assert all(result.skipped > 0 and result.declined == 0 for result in verdict.results)
    assert not verdict_on(convenient, checks, 30).passed
    problem = DirectionProblem([1.0, 0.0], [[0.0, 1.0]], equality=True)
    assert check_stationarity(SimpleNamespace(solve=limited), problem) == Outcome.UNSUPPORTED


def test_a_supports_or_a_tolerance_that_wavers_is_refused():
    asked = []

    def wavers(_):
        asked.append(True)
        return len(asked) % 3 != 0

    verdict = verdict_on(CORRECT.solve, ["check_stationarity"], 6, supports=wavers)
    assert "supports should say the same of one problem each time" in verdict.results[0].problem

    class Elastic:
        tolerances = iter([1e-6] * 4 + [1e-3] * 10_000)
        tolerance = property(lambda self: next(self.tolerances))
        solve = staticmethod(CORRECT.solve)

    verdict = check_direction_solver(Elastic(), checks=["check_stationarity"], max_examples=6)
    assert "tolerance should be one number; found" in verdict.results[0].problem
    with pytest.raises(LawError):
        verdict.raise_for_failures()
