"""Mutation evidence: known-bad solvers fail the kit, at the right law, with a counterexample for a check by hand."""

import os
import random
import signal
import sys
import threading
import time
import warnings
from collections import Counter
from functools import cache

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, DirectionProblem
from cpgrl_opt.problems.case import ALL_CASES
from cpgrl_opt.published import CPO
from cpgrl_opt.testing import (
    LAWS,
    LawError,
    Outcome,
    check_agreement_with_enumeration,
    check_batch_is_loop,
    check_direction_solver,
    check_global_state_is_unchanged,
    check_least_violation,
    check_neighbours_change_nothing,
    check_stationarity,
)
from cpgrl_opt.testing.draws import SHAPES
from cpgrl_opt.testing.examination import _Draws, _traceless, first_break
from cpgrl_opt.testing.law import vary

from .bad_solvers import (
    BAD,
    BATCHES,
    CORRECT,
    GEOMETRY,
    SOMEWHERE,
    Faulty,
    Right,
    ScalesTheBatch,
    balls,
    changing_settings,
    in_batches,
    kappa_turned,
    the_gradient,
    violates_least_for,
)

PROBLEM = DirectionProblem([1.0, -1.0], [[-1.0, 0.0]])
# d₁ ≥ ½ and d₁ ≤ −½: all of the line d₁ = 0 violates least, and (0, 2, 0) climbs best.
OPPOSING = DirectionProblem([1.0, 3.0, 0.0], [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], [0.5, 0.5], radius=2.0)


@pytest.mark.parametrize("name", BAD)
def test_a_bad_solver_breaks_the_law_that_is_about_it(name):
    bad = BAD[name]
    assert first_break(LAWS[bad.check], bad.make(), max_examples=bad.examples).broken


# One for each kind of arguments that a law has; to shrink them all would take a minute.
SHRUNK = {
    "unit length": CORRECT,
    "every row an equality": CORRECT,
    "infeasible without proof": CORRECT,
    "warns": CORRECT,
    "batch: each the next": CORRECT,
    "CPO, κ lost": CPO(),
}


@pytest.mark.parametrize("name", SHRUNK)
def test_the_counterexample_is_small_and_runs(name):
    """n, m ≤ 3, few numbers, and integers of two digits at most."""
    bad = BAD[name]
    result = check_direction_solver(bad.make(), checks=[bad.check], max_examples=20)[bad.check]
    assert result.failed > 0
    scope, asked = {}, []
    exec(result.counterexample, scope)
    test = scope[f"test_{bad.law}_holds_here"]
    with pytest.raises(LawError):
        test(bad.make())
    test(SHRUNK[name])
    scope[bad.check] = lambda _, **given: asked.extend(given.get("problems", [given.get("problem")]))
    test(None)
    assert len(asked) <= 2
    assert ("radius=" in result.counterexample) == balls(asked[0])
    numbers = np.concatenate([np.ravel(part) for p in asked for part in (p.gradient, p.jacobian, p.bound)])
    assert np.count_nonzero(numbers) <= 7
    assert max(asked[0].n, asked[0].m) <= 3
    assert np.abs(numbers).max() <= 99
    np.testing.assert_array_equal(numbers, np.round(numbers))


# What g for an answer breaks; most other laws hold of it.
BROKEN = ("check_primal_feasibility", "check_claims_are_certified")


@cache
def long_draws(law):
    """What a run of 300 examples puts to solvers of all constraints; of 100 two have n = 200, and may be feasible."""
    with _traceless():
        return _Draws(LAWS[law].arguments, ALL_CASES, 300, 0)._draw_all()


def breaks(solver, law):
    """Whether the law breaks on one of these problems."""
    for arguments in long_draws(law):
        try:
            LAWS[law].check(solver, **arguments)
        except LawError:
            return True
    return False


@pytest.mark.parametrize("where", SOMEWHERE)
def test_a_solver_that_is_wrong_at_some_shape_or_face_only_is_rejected(where):
    solver = Faulty(the_gradient, SOMEWHERE[where])
    assert any(breaks(solver, law) for law in BROKEN)


def test_a_long_run_has_every_listed_shape_and_many_others():
    problems = [arguments["problem"] for law in BROKEN for arguments in long_draws(law)]
    found = Counter((problem.n, problem.m) for problem in problems)
    assert {(1, 1), (200, 3), (40, 12)} <= set(SHAPES) <= set(found)
    assert len(found) > 50


def starts_a_thread():
    threading.Thread(target=time.sleep, args=(0.5,), daemon=True).start()


DEEDS = {
    "NumPy's seed": lambda: np.random.seed(0),  # noqa: NPY002 - the fault
    "NumPy's numbers": lambda: np.random.rand(),  # noqa: NPY002 - the fault
    "Python's seed": lambda: random.seed(0),
    "np.seterr": lambda: changing_settings(None, None),
    "np.seterrcall": lambda: np.seterrcall(print),
    "np.set_printoptions": lambda: np.set_printoptions(precision=3),
    "warnings.filters": lambda: warnings.simplefilter("ignore"),
    "os.environ": lambda: os.environ.update(OMP_NUM_THREADS=str(1 + len(os.environ.get("OMP_NUM_THREADS", "")))),
    "the folder": lambda: os.chdir("/"),
    "sys.stdout": lambda: setattr(sys, "stdout", sys.__stderr__),
    "the recursion limit": lambda: sys.setrecursionlimit(sys.getrecursionlimit() + 1),
    "a signal": lambda: signal.signal(signal.SIGTERM, signal.SIG_IGN),
    "a thread": starts_a_thread,
}


def state():
    return np.geterr(), os.getcwd(), sys.stdout, signal.getsignal(signal.SIGTERM), dict(os.environ)


@pytest.mark.parametrize("deed", DEEDS)
def test_what_is_done_to_the_process_is_seen_and_undone(deed):
    before = state()
    with pytest.raises(LawError, match="leave the process as it was"):
        check_global_state_is_unchanged(Faulty(lambda _, answer: (DEEDS[deed](), answer)[1]), PROBLEM)
    assert state() == before


def test_what_an_earlier_law_has_let_a_solver_change_is_seen_by_the_law_about_it(monkeypatch):
    monkeypatch.delenv("LEFT_BY_A_SOLVER", raising=False)
    changing = Faulty(lambda _, answer: os.environ.update(LEFT_BY_A_SOLVER="1") or answer)
    checks = ["check_stationarity", "check_global_state_is_unchanged"]
    assert not check_direction_solver(changing, checks=checks, max_examples=3).passed


def test_a_batch_by_hand_shows_what_is_wrong():
    infeasible = DirectionProblem([1.0, 0.0], [[0.0, 0.0]], [1.0])
    with pytest.raises(LawError, match=r"solve_batch\(problems\)\[1\] should have the status INFEASIBLE"):
        check_batch_is_loop(in_batches(BATCHES["all are called OPTIMAL"]), [PROBLEM, infeasible])


@pytest.mark.parametrize("factor", [0.0, -1.0])
def test_the_least_violation_in_a_ball_that_climbs_less_is_told_so(factor):
    assert check_least_violation(CORRECT, OPPOSING) == Outcome.HELD
    with pytest.raises(LawError, match="take the one that climbs most"):
        check_least_violation(violates_least_for(factor), OPPOSING)


def test_a_ball_that_holds_back_leaves_one_direction_only():
    """(2, 2) is asked for from a ball of 1: its point (√½, √½) violates least, whatever g is."""
    missing = DirectionProblem([3.0, -1.0], np.eye(2), 2.0, radius=1.0)
    assert check_least_violation(CORRECT, missing) == Outcome.HELD
    towards = BAD["infeasible with the gradient"].make().fault
    with pytest.raises(LawError, match="stay in the ball and violate the constraints least"):
        check_least_violation(Faulty(towards, **GEOMETRY), missing)


def test_a_batch_in_a_common_unit_changes_last_digits_and_is_rejected():
    near = DirectionProblem([1.0, 2.0, 0.0], [[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]], radius=2.0)
    far = vary(near, gradient=1e7 * near.gradient)
    assert check_batch_is_loop(ScalesTheBatch(), [near, far]) == Outcome.HELD
    with pytest.raises(LawError, match="not in its last bit"):
        check_neighbours_change_nothing(ScalesTheBatch(), near, [near], [far])


@pytest.mark.parametrize("name", ["active-set", "nnls", "osqp"])
def test_a_run_in_a_batch_with_radius_has_the_same_bits_beside_extreme_rows(name):
    """Faults A9: a neighbour's row of 1e300 made the whole batch be rescaled."""
    near = DirectionProblem([1.0, 2.0, 0.0], [[1.0, -1.0, 0.0], [0.0, -1.0, 1.0]], radius=2.0)
    extreme = vary(near, jacobian=1e300 * near.jacobian, gradient=1e-290 * near.gradient)
    for metric in (None, [1.0, 3.0, 7.0]):
        problem, other = vary(near, metric=metric), vary(extreme, metric=metric)
        assert check_neighbours_change_nothing(SOLVERS[name], problem, [problem, problem], [other, problem]) == "held"


@pytest.mark.parametrize("told", [-1.0, float("nan"), 1e300, None])
def test_the_reported_multiplier_of_the_ball_decides_neither_what_is_compared_nor_how_exactly(told):
    """Half the optimum is no optimum, however the ball is said to bind; what is compared is the problem's affair."""

    class Half(Right):
        takes_geometry = True

        def solve(self, problem):
            answer = CORRECT.solve(problem)
            self.value, self.multipliers, self.status = answer.value / 2, answer.multipliers, answer.status
            if told is not None:
                self.radius_multiplier = told
            return self

    binding = DirectionProblem([3.0, 4.0], [[1.0, 0.0]], 1.0, radius=2.0)
    with pytest.raises(LawError, match="d\\* by enumeration"):
        check_agreement_with_enumeration(Half(), binding)
    slack = DirectionProblem([-3.0, 0.0], [[1.0, 0.0]], radius=2.0)  # d = 0, or any (0, t) in the ball
    assert check_agreement_with_enumeration(Half(), slack) == Outcome.SKIPPED


def test_a_broken_law_shows_the_geometry():
    problem = DirectionProblem([1.0, 2.0], [[1.0, 0.0]], metric=[2.0, 1.0], radius=0.5)
    with pytest.raises(LawError, match=r"(?s)metric .*radius .*κ"):
        check_stationarity(Faulty(kappa_turned, **GEOMETRY), problem)
