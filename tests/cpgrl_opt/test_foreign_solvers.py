"""Somebody else's solver, rule or observer: it cannot change what it is judged by, and hears what should come."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import blas

from cpgrl_opt import (
    SOLVERS,
    ConstrainedStep,
    Direction,
    DirectionBatch,
    DirectionProblem,
    Linearization,
    ProblemBatch,
    Status,
    WithGeometry,
)
from cpgrl_opt.comparison import bench
from cpgrl_opt.comparison.contestants import Contestant
from cpgrl_opt.solvers import referee

# With rates 1 the step is [1, 0.1]: the row [0, 10] asks for 10 d₂ ≥ 1. On a unit row it would ask for d₂ ≥ 1.
LINEARIZATION = Linearization([0.0, -1.0], [[1.0, 0.0], [0.0, 10.0]])
TWO = Linearization(np.stack([LINEARIZATION.values] * 2), np.stack([LINEARIZATION.gradients] * 2))
PROBLEM = DirectionProblem([1.0, 0.0], [[0.0, 10.0]], [1.0], metric=[1.0, 4.0])


def step_of(solver, **settings):
    settings = {"step_size": 1.0, "restoration_rate": 1.0, "formulation": "restoring", **settings}
    return ConstrainedStep(solver=solver, **settings)


def divide(rows):
    """Rows to length 1 in place, as one would write it."""
    rows /= np.linalg.norm(rows, axis=-1, keepdims=True)


def divide_by_blas(rows):
    """The same by BLAS, which does not look at NumPy's flags."""
    for row in rows.reshape(-1, rows.shape[-1]):
        blas.dscal(1.0 / np.linalg.norm(row), row)


def divide_with_the_flag_turned(rows):
    rows.flags.writeable = True
    divide(rows)


@dataclass(frozen=True)
class UnitRows:
    """Makes unit rows in place, and forgets b."""

    divide: object

    def solve(self, problem):
        self.divide(problem.jacobian)
        return SOLVERS["active-set"].solve(problem)


@dataclass(frozen=True)
class UnitRowsOfBatches(UnitRows):
    def solve_batch(self, problems):
        self.divide(problems.jacobian)
        return SOLVERS["active-set"].solve_batch(problems)


BOTH = pytest.mark.parametrize("kind", [UnitRows, UnitRowsOfBatches])


@BOTH
@pytest.mark.parametrize("settings", [{}, {"metric": [1.0, 1.0]}])
def test_a_solver_that_writes_to_the_problem_is_named_and_told_to_copy(kind, settings):
    solver = WithGeometry(kind(divide)) if settings else kind(divide)
    with pytest.raises(ValueError, match=rf"work on copies; found {kind.__name__}.*read-only"):
        step_of(solver, **settings)(LINEARIZATION, [0.0])


@BOTH
@pytest.mark.parametrize("settings", [{}, {"metric": [1.0, 1.0]}, {"radius": 10.0}])
@pytest.mark.parametrize("how", [divide_by_blas, divide_with_the_flag_turned])
def test_a_solver_that_writes_past_the_flag_is_judged_by_the_problem_as_it_was(kind, settings, how):
    solver = WithGeometry(kind(how)) if settings else kind(how)
    found = step_of(solver, **settings)(LINEARIZATION, [0.0])
    np.testing.assert_allclose(found.change, step_of("active-set", **settings)(LINEARIZATION, [0.0]).change, rtol=1e-9)
    if not settings:
        np.testing.assert_allclose(found.change, [1.0, 0.1], rtol=1e-12)
        assert found.counts["fallback"] == 1


@BOTH
def test_a_comparison_judges_by_the_problem_as_it_was(kind, monkeypatch):
    solver = kind(divide_by_blas)
    monkeypatch.setattr(bench, "contestant", lambda *_: Contestant(solver.solve, lambda _: True))
    problem = DirectionProblem([1.0, 0.0], [[0.0, 10.0]], [1.0])
    at = bench.Bench()
    monkeypatch.setattr(at, "problem", lambda *_: bench.Drawn(problem, True, None))
    order = bench.Order("active-set", "prepared", "random-3", 0, 0, 1.0, 1)
    monkeypatch.setattr(bench, "family_named", lambda _: None)
    at.prepare(order)
    assert at.measure().outcome == "silently-wrong"
    np.testing.assert_array_equal(problem.jacobian, [[0.0, 10.0]])


def test_an_observer_that_writes_is_stopped():
    def spoil(_, answers):
        answers.multipliers[:] = 0

    with pytest.raises(ValueError, match="read-only"):
        step_of("active-set")(LINEARIZATION, [0.0], observe=spoil)


def tightened(slack, previous):
    slack -= 0.5
    return slack <= 0


def test_a_rule_that_writes_to_what_it_is_handed_is_named():
    with pytest.raises(ValueError, match=r"rule should work on copies; found .*tightened.*read-only"):
        step_of("active-set", rule=tightened)(LINEARIZATION, [0.0], np.array([False]))


def test_a_rule_may_use_its_array_again():
    mask = np.array([True])
    step = step_of("active-set", rule=lambda *_: mask)
    first = step(LINEARIZATION, [0.0])
    mask[:] = False
    assert first.active.tolist() == [True]


@dataclass(frozen=True)
class Odd:
    """Returns what it was made with; a function is called with the problem."""

    answer: object

    def solve(self, _):
        return self.answer


@dataclass(frozen=True)
class OddInBatches(Odd):
    def solve_batch(self, _):
        return self.answer


def made(**changes):
    return SimpleNamespace(**{"value": np.zeros(2), "multipliers": np.zeros(1), "status": Status.OPTIMAL, **changes})


ODD_ANSWERS = {
    "None": (None, "found None"),
    "a tuple": ((np.zeros(2), np.zeros(1), 0), r"found \(array"),
    "multipliers of another problem": (made(multipliers=np.zeros(4)), r"found multipliers of shape \(4,\)"),
    "a status that there is not": (made(status=7), "found the status 7"),
    "a word as status": (made(status="solved"), "found the status 'solved'"),
    "radius": (made(radius_multiplier=np.zeros(2)), r"found radius_multiplier of shape \(2,\)"),
}


@pytest.mark.parametrize("case", ODD_ANSWERS)
def test_a_solve_that_returns_no_direction_is_told_what_to_return(case):
    answer, found = ODD_ANSWERS[case]
    message = (
        rf"(?s)solve should return a Direction \(value \(2,\), multipliers \(1,\), status\).*{found}.*, from Odd\("
    )
    with pytest.raises(ValueError, match=message):
        step_of(Odd(answer))(LINEARIZATION, [0.0])
    for problem in (PROBLEM, DirectionProblem(PROBLEM.gradient, PROBLEM.jacobian, PROBLEM.bound, radius=1.0)):
        with pytest.raises(ValueError, match=message):
            WithGeometry(Odd(answer)).solve(problem)


def batch_of(value=(2, 2), multipliers=(2, 1), status=(0, 0)):
    parts = {"value": np.zeros(value), "multipliers": np.zeros(multipliers), "status": np.array(status)}
    return SimpleNamespace(**parts)


ODD_BATCHES = {
    "None": (None, "found None"),
    "multipliers of another shape": (batch_of(multipliers=(2, 2)), r"found multipliers of shape \(2, 2\)"),
    "one status": (batch_of(status=[0]), r"found the statuses array\(\[0\]\)"),
    "statuses that there are not": (batch_of(status=[0, 9]), "found the status 9"),
}


@pytest.mark.parametrize("case", ODD_BATCHES)
def test_a_solve_batch_that_returns_no_directions_is_told_what_to_return(case):
    answer, found = ODD_BATCHES[case]
    message = rf"(?s)solve_batch should return a DirectionBatch \(value \(2, 2\).*{found}.*, from OddInBatches\("
    with pytest.raises(ValueError, match=message):
        step_of(OddInBatches(answer))(TWO, [0.0])
    with pytest.raises(ValueError, match=r"solve should return a Direction.*found None, from OddInBatches"):
        step_of(OddInBatches([made(), None]))(TWO, [0.0])


@dataclass(frozen=True)
class Listing:
    """A right solver that returns its directions in a list, with names for statuses."""

    asked: list = field(default_factory=list, hash=False)

    def solve(self, problem):
        answer = SOLVERS["nnls"].solve(problem)
        return SimpleNamespace(value=answer.value, multipliers=answer.multipliers, status=answer.status.name.lower())

    def solve_batch(self, problems):
        self.asked.append(len(problems))
        return [self.solve(problem) for problem in problems]


def test_a_list_of_directions_is_an_answer_to_a_batch():
    """The conformance kit takes it too."""
    solver = Listing()
    found = step_of(solver)(TWO, [0.0])
    np.testing.assert_allclose(found.change, [[1.0, 0.1]] * 2, rtol=1e-12)
    assert (solver.asked, found.counts["fallback"].tolist()) == ([2], [0, 0])


def test_answers_to_other_problems_are_no_answers_to_these():
    batch = ProblemBatch([[1.0, 0.0]], [[[0.0, 10.0]]], [[1.0]], [[False]])
    answers = DirectionBatch.stack([Direction(np.zeros(2), np.zeros(1), Status.OPTIMAL)] * 2)
    with pytest.raises(ValueError, match="answers should be one for each of 1 problems; found 2"):
        referee(batch, answers, 1e-6)


@pytest.mark.parametrize("said", [None, 1, "yes", np.array([True, False])])
def test_supports_that_says_neither_yes_nor_no_is_refused(said):
    solver = SimpleNamespace(solve=SOLVERS["active-set"].solve, supports=lambda _: said)
    with pytest.raises(ValueError, match="supports should return True or False; found"):
        step_of(solver)(LINEARIZATION, [0.0])
