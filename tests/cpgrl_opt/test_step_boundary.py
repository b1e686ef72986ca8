"""What a step makes of foreign solvers that claim, decline, fail or answer in other types; numbers at the limits."""

import dataclasses
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import pytest

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
    solve_batch,
)
from cpgrl_opt.solvers import ActiveSet

from .steps import ACTIVE_ONLY, Claiming, drawn, plain, require_same

LINEARIZATION = Linearization([0.0, -1.0, -0.5], [[1.0, 1.0, 0.0], [-1.0, 2.0, 0.0], [0.0, 1.0, 1.0]])
THRESHOLDS = [0.0, 0.0]


@pytest.mark.parametrize("formulation", ACTIVE_ONLY)
@pytest.mark.parametrize(
    "liar",
    [Claiming(None, Status.OPTIMAL, 1.0), Claiming(np.nan, Status.OPTIMAL), Claiming(None, Status.INFEASIBLE, 1.0)],
)
def test_a_foreign_claim_that_the_referee_rejects_falls_back(formulation, liar):
    exact = ConstrainedStep(formulation=formulation)(LINEARIZATION, THRESHOLDS)
    result = ConstrainedStep(solver=liar, formulation=formulation)(LINEARIZATION, THRESHOLDS)
    np.testing.assert_array_equal(result.change, exact.change)
    assert result.counts["fallback"] >= 1
    assert result.counts["infeasible"] == 0


class SubclassOfOurs(ActiveSet):
    """Not ours any more."""

    def solve_batch(self, problems):
        answers = super().solve_batch(problems)
        return dataclasses.replace(answers, value=np.full_like(answers.value, 7.0))


def test_a_subclass_of_a_solver_of_ours_is_put_before_the_referee():
    result = ConstrainedStep(solver=SubclassOfOurs())(LINEARIZATION, THRESHOLDS)
    np.testing.assert_array_equal(result.change, ConstrainedStep()(LINEARIZATION, THRESHOLDS).change)
    assert result.counts["fallback"] == 2


@dataclass(frozen=True)
class Typed:
    """A right solver whose arrays are of another type or order than ours."""

    form: str

    takes_geometry: ClassVar[bool] = True

    def solve(self, problem):
        answer = SOLVERS["nnls"].solve(problem)
        return Direction(answer.value.astype(np.float32), answer.multipliers.astype(np.float32), answer.status)


@dataclass(frozen=True)
class TypedBatches(Typed):
    """The same with a `solve_batch` of its own."""

    def solve_batch(self, problems):
        answers = DirectionBatch.stack([SOLVERS["nnls"].solve(problem) for problem in problems])
        value = np.asfortranarray(answers.value)
        value.flags.writeable = False
        return dataclasses.replace(answers, value=value, status=answers.status.astype(np.int8))


@pytest.mark.parametrize("metric", [None, [1.0, 1.0, 1.0]])
@pytest.mark.parametrize(
    "solver",
    [Typed("float32"), TypedBatches("read-only, columns first, statuses of int8")],
    ids=lambda solver: solver.form,
)
def test_answers_of_any_type_and_order_are_taken(solver, metric):
    many = Linearization(np.stack([LINEARIZATION.values] * 2), np.stack([LINEARIZATION.gradients] * 2))
    for drop in ("stationary", "always"):
        exact, found = (ConstrainedStep(solver=each, metric=metric, drop=drop) for each in ("nnls", solver))
        change = found(many, THRESHOLDS).change
        np.testing.assert_allclose(change, exact(many, THRESHOLDS).change, rtol=1e-5, atol=1e-9)


@dataclass(frozen=True)
class ConesOnly:
    """Takes Jd ≥ 0, and is sure to be wrong elsewhere: it would call g optimal of anything with a bound."""

    asked: list[DirectionProblem] = field(default_factory=list)

    def supports(self, problem: DirectionProblem) -> bool:
        return bool(((problem.bound == 0.0) | (problem.bound == -np.inf)).all()) and not problem.equality.any()

    def solve(self, problem: DirectionProblem) -> Direction:
        assert self.supports(problem), "asked for what it does not take"
        self.asked.append(problem)
        return SOLVERS["active-set"].solve(problem)


class ConesTogether(ConesOnly):
    """The same with a `solve_batch` of its own."""

    def solve_batch(self, problems) -> DirectionBatch:
        return DirectionBatch.stack([self.solve(problem) for problem in problems])


@pytest.mark.parametrize("kind", [ConesOnly, ConesTogether])
@pytest.mark.parametrize("settings", [{}, {"metric": np.diag([1.0, 2.0, 3.0, 4.0, 5.0])}, {"radius": 0.1}])
def test_only_what_it_takes_is_asked_and_the_rest_falls_back(settings, kind) -> None:
    given = drawn(5, 2, 5, runs=(6,))
    for formulation in ACTIVE_ONLY:
        solver = kind()
        foreign = WithGeometry(solver) if settings else solver
        done, exact = (
            plain(solver=each, formulation=formulation, **settings)(given, [1.0, 1.0])
            for each in (foreign, "active-set")
        )
        np.testing.assert_allclose(done.change, exact.change, atol=1e-9)
        assert 0 < done.counts["fallback"].sum() <= (2 if formulation == "equality" else 1) * 6
        assert not done.counts["skipped"].any()
        assert (formulation == "cone") == bool(solver.asked)


@pytest.mark.parametrize("stacked", [False, True])
@pytest.mark.parametrize("bounds", [[0.0, 1.0, 0.0, -1.0], [0.0, 0.0], [1.0, -1.0]])
def test_a_batch_of_its_own_is_handed_what_it_takes_and_the_answers_stay_in_order(bounds, stacked) -> None:
    solver = ConesTogether()
    problems = [DirectionProblem([1.0, k], [[-1.0, 0.5]], bound) for k, bound in enumerate(bounds)]
    answers = solve_batch(solver, ProblemBatch.stack(problems) if stacked else problems)
    for answer, problem in zip(answers, problems, strict=True):
        takes = solver.supports(problem)
        assert answer.status == (Status.OPTIMAL if takes else Status.UNSUPPORTED)
        expected = SOLVERS["active-set"].solve(problem).value if takes else np.zeros(2)
        np.testing.assert_array_equal(answer.value, expected)
    assert len(solver.asked) == bounds.count(0.0)
    balls = [DirectionProblem([1.0, k], [[-1.0, 0.5]], radius=1.0) for k in range(3)]  # which it does not declare
    assert [answer.status for answer in solve_batch(solver, balls)] == [Status.UNSUPPORTED] * 3


def change(value, threshold, gradients, **settings):
    with np.errstate(over="ignore"):
        return ConstrainedStep(**settings)(Linearization([0.0, value], gradients), [threshold])


STEEP = [[1e300, 1e300], [1.0, 0.0]]


@pytest.mark.parametrize(
    ("message", "make"),
    [
        ("values − thresholds should be finite", lambda: change(-1.7e308, 1.7e308, [[1.0], [1.0]])),
        (
            "slack, times restoration_rate / step_size",
            lambda: change(-1e200, 0.0, [[1.0], [1.0]], formulation="restoring", step_size=1e-200),
        ),
        ("step_size .* lower the rates", lambda: change(1.0, 0.0, STEEP, step_size=1e10)),
        (
            "gradients should be finite where the metric is the identity",
            lambda: change(-1.0, 0.0, [[1.0, 1.0], [1e200, 1.0]], metric=[1e-250, 1.0]),
        ),
        (
            "in the units of the metric",
            lambda: change(1.0, 0.0, [[1e160, 1.0], [0.0, 1.0]], metric=[1e-200, 1.0]),
        ),
    ],
)
def test_what_overflows_is_refused_by_its_name(message, make):
    with pytest.raises((ValueError, FloatingPointError), match=message):
        make()


@pytest.mark.parametrize("metric", [None, [1.0, 1.0]])
@pytest.mark.parametrize("formulation", ACTIVE_ONLY)
@pytest.mark.parametrize(("size", "n"), [(1e120, 2), (1e204, 2), (1e204, 200_000)])
def test_a_slack_that_leaves_float64_is_infinite_with_its_sign_and_no_nan(size, n, formulation, metric):
    """Nothing is violated: 0.02 Δ¹, and J · change = ±(1 − ½) 0.02 size², of terms that overflow with either sign."""
    gradients = np.zeros((3, n))
    gradients[:, :2] = size * np.array([[1.0, 1.0], [-0.5, 1.0], [0.5, -1.0]])
    step = ConstrainedStep(formulation=formulation, metric=metric if n == 2 else None)
    result = step(Linearization([0.0, 1.0, 1.0], gradients), np.zeros(2))
    at = 0.01 * size * size
    np.testing.assert_allclose(result.predicted_slack, [at, -at], rtol=1e-12)


def test_a_step_that_was_pickled_before_it_had_a_slack_fraction_still_steps():
    """Its state is what pickle hands back: no slack_fraction, a geometry that it no longer has, and fewer arguments."""
    step = ConstrainedStep(formulation="cone", step_size=0.1)
    state = {name: value for name, value in vars(step).items() if name != "slack_fraction"}
    old = object.__new__(ConstrainedStep)
    old.__setstate__({**state, "_geometry": None, "_direct": (False, False, False, 0.1, 0.02, 1e-6, 1e-10)})
    require_same(old(LINEARIZATION, THRESHOLDS), step(LINEARIZATION, THRESHOLDS))
    assert old.slack_fraction == 1.0
