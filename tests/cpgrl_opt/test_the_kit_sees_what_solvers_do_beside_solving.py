"""Solvers whose answers are right and which are wrong all the same: each is rejected by the law that is about it."""

import contextlib
import io
import os
import random
import signal
import sys
import threading
import time
import warnings

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, Direction, DirectionProblem, Status
from cpgrl_opt.direction import DirectionBatch
from cpgrl_opt.scaling import unit_rows
from cpgrl_opt.testing import (
    LAWS,
    LawBroken,
    check_answers_stay,
    check_batch_is_loop,
    check_direction_solver,
    check_global_state_is_unchanged,
    check_threads_do_not_meet,
    check_time_is_in_proportion,
)
from cpgrl_opt.testing.examination import first_break
from cpgrl_opt.testing.law import varied

CORRECT = SOLVERS["active-set"]
PROBLEM = DirectionProblem([1.0, -1.0], [[-1.0, 0.0]])
OTHER = DirectionProblem([2.0, 5.0], [[-1.0, 0.0]])


def breaks(solver, name, max_examples):
    """Whether the law breaks on one of the problems that a run draws."""
    return first_break(LAWS[name], solver, max_examples=max_examples).broken


class Right:
    """active-set, without anything but `solve`."""

    def solve(self, problem):
        return CORRECT.solve(problem)


class OneBuffer(Right):
    """Every answer of one shape is in the same arrays."""

    def __init__(self):
        self.buffers = {}

    def solve(self, problem):
        answer = CORRECT.solve(problem)
        value, mu = self.buffers.setdefault((problem.n, problem.m), (np.zeros(problem.n), np.zeros(problem.m)))
        value[:], mu[:] = answer.value, answer.multipliers
        return Direction(value, mu, answer.status)


class Remembers(Right):
    """Problems that were solved before get the very array that was returned then."""

    def __init__(self):
        self.known = {}

    def solve(self, problem):
        key = problem.gradient.tobytes() + problem.jacobian.tobytes() + problem.bound.tobytes()
        key += problem.equality.tobytes() + repr(problem.radius).encode()
        return self.known.setdefault(key, CORRECT.solve(problem))


class OneBufferForBatches(Right):
    def __init__(self):
        self.buffers = {}

    def solve_batch(self, problems):
        fresh = DirectionBatch.stack([CORRECT.solve(problem) for problem in problems])
        kept = self.buffers.setdefault(fresh.value.shape, np.zeros(fresh.value.shape))
        kept[:] = fresh.value
        return DirectionBatch(kept, fresh.multipliers, fresh.status, fresh.iterations)


@pytest.mark.parametrize("solver", [OneBuffer, Remembers, OneBufferForBatches])
def test_an_answer_that_does_not_stay_is_rejected(solver):
    assert breaks(solver(), "check_answers_stay", 40)
    with pytest.raises(LawBroken):
        check_answers_stay(solver(), PROBLEM, OTHER)


def test_answers_that_are_the_problems_own_arrays_or_read_only_are_no_fault():
    class Frugal(Right):
        def solve(self, problem):
            answer = CORRECT.solve(problem)
            if (answer.value == problem.gradient).all():
                return Direction(problem.gradient, answer.multipliers, answer.status)
            answer.value.flags.writeable = False
            return answer

    assert check_direction_solver(Frugal(), checks=["check_answers_stay"], max_examples=30).passed


class WorksInItself(Right):
    """What it works with are attributes."""

    def solve(self, problem):
        self.gradient, self.constraints = problem.gradient, (problem.jacobian, problem.bound, problem.equality)
        time.sleep(0)
        return CORRECT.solve(DirectionProblem(self.gradient, *self.constraints))


class SwapsStreams(Right):
    """Keeps a back end silent by a stream of its own."""

    def solve(self, problem):
        with contextlib.redirect_stdout(io.StringIO()):
            time.sleep(0)
            return CORRECT.solve(problem)


class SwapsFilters(Right):
    def solve(self, problem):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            time.sleep(0)
            return CORRECT.solve(problem)


class NoTwoAtOnce(Right):
    """Its back end raises where it is called while it is busy."""

    def __init__(self):
        self.busy = threading.Lock()

    def solve(self, problem):
        if not self.busy.acquire(blocking=False):
            raise RuntimeError("the workspace is in use")
        try:
            time.sleep(0)
            return CORRECT.solve(problem)
        finally:
            self.busy.release()


@pytest.mark.parametrize("solver", [WorksInItself, SwapsStreams, SwapsFilters, NoTwoAtOnce])
def test_threads_that_meet_are_rejected(solver):
    assert breaks(solver(), "check_threads_do_not_meet", 20)


def test_threads_that_take_turns_are_not():
    class TakesTurns(Right):
        turn = threading.Lock()

        def solve(self, problem):
            with self.turn, contextlib.redirect_stdout(io.StringIO()):
                return CORRECT.solve(problem)

    streams = (sys.stdin, sys.stdout, sys.stderr)
    assert check_threads_do_not_meet(TakesTurns(), PROBLEM, OTHER) == "held"
    assert (sys.stdin, sys.stdout, sys.stderr) == streams


def starts_a_thread():
    threading.Thread(target=time.sleep, args=(0.5,), daemon=True).start()


DEEDS = {
    "NumPy's seed": lambda: np.random.seed(0),  # noqa: NPY002 - the fault
    "NumPy's numbers": lambda: np.random.rand(),  # noqa: NPY002 - the fault
    "Python's seed": lambda: random.seed(0),
    "np.seterr": lambda: np.seterr(all="ignore"),
    "np.seterrcall": lambda: np.seterrcall(print),
    "np.set_printoptions": lambda: np.set_printoptions(precision=3),
    "warnings.filters": lambda: warnings.simplefilter("ignore"),
    "os.environ": lambda: os.environ.update(OMP_NUM_THREADS=str(1 + len(os.environ.get("OMP_NUM_THREADS", "")))),
    "the folder": lambda: os.chdir("/"),
    "sys.stdout": lambda: setattr(sys, "stdout", io.StringIO()),
    "the recursion limit": lambda: sys.setrecursionlimit(sys.getrecursionlimit() + 1),
    "a signal": lambda: signal.signal(signal.SIGTERM, signal.SIG_IGN),
    "a thread": starts_a_thread,
}


@pytest.mark.parametrize(
    ("deed", "when"), [*((deed, "always") for deed in DEEDS), ("np.seterr", "where it is infeasible")]
)
def test_what_is_done_to_the_process_is_seen_and_undone(deed, when):
    class Doing(Right):
        def solve(self, problem):
            answer = CORRECT.solve(problem)
            if when == "always" or answer.status == Status.INFEASIBLE:
                DEEDS[deed]()
            return answer

    before = np.geterr(), os.getcwd(), sys.stdout, signal.getsignal(signal.SIGTERM), dict(os.environ)
    if when == "always":
        with pytest.raises(LawBroken, match="leave the process as it was"):
            check_global_state_is_unchanged(Doing(), PROBLEM)
    else:
        assert breaks(Doing(), "check_global_state_is_unchanged", 30)
    assert (np.geterr(), os.getcwd(), sys.stdout, signal.getsignal(signal.SIGTERM), dict(os.environ)) == before


def test_what_an_import_changes_once_is_no_fault():
    class Imports(Right):
        first = True

        def solve(self, problem):
            if self.first:
                self.first = False
                warnings.filterwarnings("ignore", message="of the package that is imported now")
                os.environ["LAWS_TEST_IMPORTED"] = "1"
            return CORRECT.solve(problem)

    assert check_global_state_is_unchanged(Imports(), PROBLEM) == "held"
    assert "LAWS_TEST_IMPORTED" not in os.environ


def depends(problem):
    return problem.m > 1 and np.linalg.matrix_rank(problem.jacobian) < min(problem.m, problem.n)


def test_a_pause_at_some_problems_is_rejected():
    class Pauses(Right):
        def solve(self, problem):
            answer = CORRECT.solve(problem)
            if depends(problem):
                time.sleep(0.3)
            return answer

    assert breaks(Pauses(), "check_time_is_in_proportion", 40)


def test_a_first_call_that_compiles_and_a_solver_that_is_slow_throughout_are_not():
    class Compiles(Right):
        def __init__(self):
            self.known = set()

        def solve(self, problem):
            if problem.jacobian.shape not in self.known:
                self.known.add(problem.jacobian.shape)
                time.sleep(0.3)
            return CORRECT.solve(problem)

    class Slow(Right):
        def solve(self, problem):
            time.sleep(0.12)
            return CORRECT.solve(problem)

    assert check_time_is_in_proportion(Compiles(), PROBLEM) == "held"
    assert check_time_is_in_proportion(Slow(), PROBLEM) == "held"


class SaysInfeasible(Right):
    """Prints where it ends in a least violation."""

    def solve(self, problem):
        answer = CORRECT.solve(problem)
        if answer.status == Status.INFEASIBLE:
            print("infeasible")  # noqa: T201 - the fault
        return answer


def test_what_is_said_at_some_kind_of_problem_is_heard():
    assert breaks(SaysInfeasible(), "check_silence", 40)


class Batches(Right):
    """The loop, then changed by `changed(answers)`."""

    def __init__(self, changed):
        self.changed = changed

    def solve_batch(self, problems):
        return self.changed([CORRECT.solve(problem) for problem in problems])


def replaced_from(count):
    return lambda answers: [answers[min(k, count)] for k in range(len(answers))]


BATCHES = {
    "all are called OPTIMAL": lambda answers: [Direction(a.value, a.multipliers, Status.OPTIMAL) for a in answers],
    "infeasible ones come first": lambda answers: sorted(answers, key=lambda a: -int(a.status == Status.INFEASIBLE)),
    "the 33rd for all after it": replaced_from(32),
    "the last two are swapped": lambda answers: [*answers[:-2], *answers[-2:][::-1]],
    "reversed where there are many": lambda answers: answers[::-1] if len(answers) > 8 else answers,
}


@pytest.mark.parametrize("what", BATCHES)
def test_a_batch_that_is_no_loop_is_rejected(what):
    assert breaks(Batches(BATCHES[what]), "check_batch_is_loop", 60)


def test_a_batch_that_is_a_loop_is_not():
    assert check_direction_solver(Batches(list), checks=["check_batch_is_loop"], max_examples=20).passed


class NeedsAnInterior(Right):
    """Calls infeasible what has no interior, by rows that oppose each other where they meet."""

    def solve(self, problem):
        rows = unit_rows(problem.jacobian)
        bound = rows.per_length(problem.bound)
        for i in range(problem.m):
            opposed = (rows.jacobian @ rows.jacobian[i] < -1 + 1e-12) & (np.abs(bound + bound[i]) < 1e-12)
            if (opposed & ~problem.equality).any() and bound[i] != 0 and not problem.equality[i]:
                return Direction(problem.gradient, np.ones(problem.m), Status.INFEASIBLE)
        return CORRECT.solve(problem)


class NeedsMoreThanOnePoint(Right):
    """Calls infeasible one point ≠ 0 that inequalities leave. It passed a whole default run of commit 779aebc."""

    def solve(self, problem):
        answer = CORRECT.solve(problem)
        if answer.status == Status.OPTIMAL and problem.bound.any() and not problem.equality.any():
            far = 1e3 * (1.0 + np.abs(answer.value).max()) * np.vstack([np.eye(problem.n), -np.eye(problem.n)])
            others = (CORRECT.solve(varied(problem, gradient=gradient)) for gradient in far)
            if all(np.abs(other.value - answer.value).max() < 1e-9 for other in others):
                return Direction(answer.value, np.ones(problem.m), Status.INFEASIBLE)
        return answer


@pytest.mark.parametrize("solver", [NeedsAnInterior, NeedsMoreThanOnePoint])
def test_a_pinched_set_that_is_called_infeasible_is_rejected(solver):
    assert breaks(solver(), "check_feasible_is_not_called_infeasible", 100)


def test_a_batch_by_hand_shows_what_is_wrong():
    infeasible = DirectionProblem([1.0, 0.0], [[0.0, 0.0]], [1.0])
    with pytest.raises(LawBroken, match=r"solve_batch\(problems\)\[1\] should have the status INFEASIBLE"):
        check_batch_is_loop(Batches(BATCHES["all are called OPTIMAL"]), [PROBLEM, infeasible])


def test_what_an_earlier_law_has_let_a_solver_change_is_seen_by_the_law_about_it(monkeypatch):
    monkeypatch.delenv("LEFT_BY_A_SOLVER", raising=False)

    class Changing:
        def solve(self, problem):
            os.environ["LEFT_BY_A_SOLVER"] = "1"
            return SOLVERS["active-set"].solve(problem)

    checks = ["check_stationarity", "check_global_state_is_unchanged"]
    assert not check_direction_solver(Changing(), checks=checks, max_examples=3).passed
