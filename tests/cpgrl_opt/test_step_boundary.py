"""What a step makes of foreign solvers, of arrays as other libraries hand them out, and of numbers at the limits."""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from cpgrl_opt import (
    SOLVERS,
    ConstrainedStep,
    Direction,
    DirectionBatch,
    Linearization,
    Status,
)
from cpgrl_opt.solvers import ActiveSet, WithGeometry

FORMULATION_NAMES = ["equality", "cone", "restoring"]
LINEARIZATION = Linearization([0.0, -1.0, -0.5], [[1.0, 1.0, 0.0], [-1.0, 2.0, 0.0], [0.0, 1.0, 1.0]])
THRESHOLDS = [0.0, 0.0]


@dataclass(frozen=True)
class Claiming:
    """Answers every problem with the same claim: of g, of NaN, or of infeasibility without proof."""

    value: float | None
    status: Status

    def solve(self, problem):
        value = problem.gradient if self.value is None else np.full(problem.n, self.value)
        return Direction(value, np.ones(problem.m), self.status)


@dataclass(frozen=True)
class Honest:
    """A third party's solver that is right."""

    def solve(self, problem):
        answer = SOLVERS["nnls"].solve(problem)
        return Direction(answer.value, answer.multipliers, answer.status)


@pytest.mark.parametrize("formulation", FORMULATION_NAMES)
@pytest.mark.parametrize(
    "liar", [Claiming(None, Status.OPTIMAL), Claiming(np.nan, Status.OPTIMAL), Claiming(None, Status.INFEASIBLE)]
)
def test_a_foreign_claim_that_the_referee_rejects_falls_back(formulation, liar):
    exact = ConstrainedStep(formulation=formulation)(LINEARIZATION, THRESHOLDS)
    result = ConstrainedStep(solver=liar, formulation=formulation)(LINEARIZATION, THRESHOLDS)
    np.testing.assert_array_equal(result.change, exact.change)
    assert result.counts["fallback"] >= 1
    assert result.counts["infeasible"] == 0


def test_a_foreign_solver_that_is_right_is_believed():
    result = ConstrainedStep(solver=Honest())(LINEARIZATION, THRESHOLDS)
    np.testing.assert_allclose(result.change, ConstrainedStep()(LINEARIZATION, THRESHOLDS).change, atol=1e-12)
    assert result.counts["fallback"] == 0


@pytest.mark.parametrize("formulation", FORMULATION_NAMES)
def test_read_only_gradients_are_taken(formulation):
    values, gradients = LINEARIZATION.values.copy(), LINEARIZATION.gradients.copy()
    step = ConstrainedStep(formulation=formulation)
    expected = step(Linearization(values, gradients), THRESHOLDS).change
    values.flags.writeable = gradients.flags.writeable = False
    np.testing.assert_array_equal(step(Linearization(values, gradients), THRESHOLDS).change, expected)


SCALES = pytest.mark.parametrize("scale", [1e-170, 1e-150, 1e150, 1e170])


@SCALES
@pytest.mark.parametrize("formulation", ["equality", "cone"])
def test_tangents_scale_with_the_gradients_and_restorations_with_their_inverse(formulation, scale):
    scaled = Linearization(LINEARIZATION.values, scale * LINEARIZATION.gradients)
    for rates, factor in (((1.0, 0.0), scale), ((0.0, 1.0), 1.0 / scale)):
        step = ConstrainedStep(formulation=formulation, step_size=rates[0], restoration_rate=rates[1])
        found = step(scaled, THRESHOLDS)
        np.testing.assert_allclose(found.change / factor, step(LINEARIZATION, THRESHOLDS).change, rtol=1e-12)
        assert found.counts["fallback"] == found.counts["skipped"] == 0


@SCALES
def test_restoring_takes_gradients_of_any_scale(scale):
    scaled = Linearization(LINEARIZATION.values, scale * LINEARIZATION.gradients)
    found = ConstrainedStep(formulation="restoring")(scaled, THRESHOLDS)
    assert found.counts["fallback"] == found.counts["skipped"] == 0
    assert np.isfinite(found.change).all()
    assert found.change.any()


@dataclass(frozen=True)
class Typed:
    """A right solver, or one that fails, whose arrays are of another type or order than ours."""

    form: str

    takes_geometry: ClassVar[bool] = True

    def solve(self, problem):
        if self.form == "failed integers":
            failed = Direction(np.zeros(problem.n), np.zeros(problem.m), Status.NUMERICAL_ERROR)
            object.__setattr__(failed, "value", np.zeros(problem.n, int))  # past the types that tests check
            object.__setattr__(failed, "multipliers", np.zeros(problem.m, int))
            return failed
        answer = SOLVERS["nnls"].solve(problem)
        return Direction(answer.value.astype(np.float32), answer.multipliers.astype(np.float32), answer.status)


@dataclass(frozen=True)
class TypedBatches(Typed):
    """The same with a `solve_batch` of its own."""

    def solve_batch(self, problems):
        answers = DirectionBatch.stack([SOLVERS["nnls"].solve(problem) for problem in problems])
        value = np.asfortranarray(answers.value) if self.form == "columns first" else answers.value
        value.flags.writeable = self.form != "read-only"
        return dataclasses.replace(answers, value=value, status=answers.status.astype(np.int8))


@pytest.mark.parametrize("metric", [None, [1.0, 1.0, 1.0]])
@pytest.mark.parametrize(
    "solver",
    [Typed("failed integers"), Typed("float32"), TypedBatches("columns first"), TypedBatches("read-only")],
    ids=lambda solver: solver.form,
)
def test_answers_of_any_type_and_order_are_taken(solver, metric):
    many = Linearization(np.stack([LINEARIZATION.values] * 2), np.stack([LINEARIZATION.gradients] * 2))
    for drop in ("stationary", "always"):
        exact, found = (ConstrainedStep(solver=each, metric=metric, drop=drop) for each in ("nnls", solver))
        change = found(many, THRESHOLDS).change
        np.testing.assert_allclose(change, exact(many, THRESHOLDS).change, rtol=1e-5, atol=1e-9)


class SubclassOfOurs(ActiveSet):
    """Not ours any more."""

    def solve_batch(self, problems):
        answers = super().solve_batch(problems)
        return dataclasses.replace(answers, value=np.full_like(answers.value, 7.0))


def test_a_subclass_of_a_solver_of_ours_is_put_before_the_referee():
    result = ConstrainedStep(solver=SubclassOfOurs())(LINEARIZATION, THRESHOLDS)
    np.testing.assert_array_equal(result.change, ConstrainedStep()(LINEARIZATION, THRESHOLDS).change)
    assert result.counts["fallback"] == 2


@pytest.mark.parametrize("settings", [{}, {"radius": 1.0}, {"metric": [1.0, 2.0]}, {"max_restoration": 1.0}])
@pytest.mark.parametrize("solver", ["active-set", "nnls", "rosen-drop", Honest()], ids=str)
def test_no_runs_are_no_changes(solver, settings):
    if isinstance(solver, Honest) and {"radius", "metric"} & settings.keys():
        solver = WithGeometry(solver)
    for formulation in FORMULATION_NAMES:
        step = ConstrainedStep(solver=solver, formulation=formulation, **settings)
        result = step(Linearization(np.zeros((0, 3)), np.zeros((0, 3, 2))), THRESHOLDS)
        assert (result.change.shape, result.stationary.shape) == ((0, 2), (0,))


@pytest.mark.parametrize(
    ("settings", "value", "threshold", "message"),
    [
        ({}, -1.7e308, 1.7e308, "values − thresholds should be finite"),
        ({"formulation": "restoring", "step_size": 1e-200}, -1e200, 0.0, "slack, times restoration_rate / step_size"),
    ],
)
def test_a_slack_that_overflows_is_refused_by_its_name(settings, value, threshold, message):
    with np.errstate(over="ignore"), pytest.raises(ValueError, match=message):
        ConstrainedStep(**settings)(Linearization([0.0, value], [[1.0], [1.0]]), [threshold])


@pytest.mark.parametrize("formulation", ["equality", "cone", "restoring"])
def test_a_change_that_overflows_is_refused_with_what_to_lower(formulation):
    step = ConstrainedStep(formulation=formulation, step_size=1e10)
    steep = Linearization([0.0, 1.0], [[1e300, 1e300], [1.0, 0.0]])
    with pytest.raises(FloatingPointError, match=r"step_size 1e\+10.*lower the rates"):
        step(steep, [0.0])


@pytest.mark.parametrize("runs", [(2,), (1, 2), (2, 1), (2, 2)])
@pytest.mark.parametrize("order", [np.asfortranarray, lambda array: array[..., ::-1].copy()[..., ::-1]])
def test_a_step_does_not_care_how_its_arrays_lie_in_memory(runs, order):
    """V[:, columns] lies in Fortran order: a TypeError of numba, once."""
    rng = np.random.default_rng(0)
    values, gradients = -np.abs(rng.normal(size=(*runs, 4))), rng.normal(size=(*runs, 4, 3))
    step, thresholds = ConstrainedStep(), np.zeros(3)
    right = step(Linearization(values, gradients), thresholds)
    found = step(Linearization(order(values), order(gradients)), thresholds)
    assert found.change.tobytes() == right.change.tobytes()


def test_a_step_that_was_pickled_before_it_had_a_slack_fraction_still_steps():
    """Its state is what pickle hands back: no slack_fraction, a geometry that it no longer has, and fewer arguments."""
    step = ConstrainedStep(formulation="cone", step_size=0.1)
    state = {name: value for name, value in vars(step).items() if name != "slack_fraction"}
    old = object.__new__(ConstrainedStep)
    old.__setstate__({**state, "_geometry": None, "_direct": (False, False, False, 0.1, 0.02, 1e-6, 1e-10)})
    np.testing.assert_array_equal(old(LINEARIZATION, THRESHOLDS).change, step(LINEARIZATION, THRESHOLDS).change)
    assert old.slack_fraction == 1.0
