"""CONB, SUM and gradient plus restoration against hand computations; CPGRL is its step."""

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep, Linearization, restoration_move
from cpgrl_opt.active_set import hysteresis
from rl import CPGRL, ConstraintSwitching, GradientWithRestoration, WeightedSum

RNG = np.random.default_rng(0)
GRADIENTS = RNG.normal(size=(4, 4, 9))
VALUES = np.array(
    [
        [5.0, 0.1, 0.2, 0.3],  # all slacks > 0
        [5.0, -0.1, 0.2, -0.3],  # the third is the most violated
        [5.0, 0.5, 0.0, 0.3],  # = 0 counts as violated
        [5.0, -0.9, -0.2, -0.3],
    ]
)
LINEARIZATION = Linearization(VALUES, GRADIENTS)


def test_conb_follows_the_objective_or_the_most_violated_constraint() -> None:
    update = ConstraintSwitching([0, 0, 0], step_size=0.5).update(LINEARIZATION)
    expected = [GRADIENTS[0, 0], GRADIENTS[1, 3], GRADIENTS[2, 2], GRADIENTS[3, 1]]
    np.testing.assert_array_equal(update.change, 0.5 * np.array(expected))
    np.testing.assert_array_equal(update.active, VALUES[:, 1:] <= 0)
    np.testing.assert_array_equal(update.counts["objective"], [1, 0, 0, 0])


def test_conb_with_a_tolerance_follows_the_objective_where_nothing_is_violated_by_as_much() -> None:
    update = ConstraintSwitching([0, 0, 0], tolerance=0.3).update(LINEARIZATION)
    np.testing.assert_array_equal(update.counts["objective"], [1, 0, 1, 0])  # −0.3 is not > −0.3
    np.testing.assert_array_equal(update.active, VALUES[:, 1:] <= -0.3)
    expected = [GRADIENTS[0, 0], GRADIENTS[1, 3], GRADIENTS[2, 0], GRADIENTS[3, 1]]
    np.testing.assert_array_equal(update.change, 0.02 * np.array(expected))
    for wrong in (-0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match="tolerance should be a number ≥ 0; found"):
            ConstraintSwitching([0, 0, 0], tolerance=wrong)


def test_sum_follows_the_sum_of_all_gradients() -> None:
    update = WeightedSum(step_size=0.1).update(LINEARIZATION)
    np.testing.assert_allclose(update.change, 0.1 * GRADIENTS.sum(axis=1), rtol=1e-14)
    assert not update.active.any()
    update = WeightedSum([1, 0, 0, -2]).update(LINEARIZATION)
    np.testing.assert_allclose(update.change, 0.02 * (GRADIENTS[:, 0] - 2 * GRADIENTS[:, 3]), rtol=1e-14)


def test_cpgrl_is_its_step_and_remembers_the_active_set() -> None:
    step = ConstrainedStep(rule=hysteresis)
    learner, memory, previous = CPGRL(step, [0, 0, 0]), None, None
    for values in (VALUES[::-1], VALUES, VALUES + 0.005):
        linearization = Linearization(values, GRADIENTS)
        update, result = learner.update(linearization, memory), step(linearization, np.zeros(3), previous)
        memory, previous = update.memory, result.active
        np.testing.assert_array_equal(update.change, result.change)
        np.testing.assert_array_equal(update.active, result.active)
        np.testing.assert_array_equal(update.stationary, result.stationary)
        assert update.counts.keys() == result.counts.keys()
    assert update.active[2, 1]  # slack 0.005, kept because it was active: the memory arrived


def test_cpgrl_shows_every_direction_problem_to_the_observer() -> None:
    seen: list[int] = []
    CPGRL(ConstrainedStep(formulation="cone"), [0, 0, 0]).update(
        LINEARIZATION, None, lambda problems, _: seen.append(len(problems))
    )
    assert sum(seen) == 8  # a tangent and a restoration problem for each of four runs


def test_numbers_of_another_length_are_refused() -> None:
    with pytest.raises(ValueError, match="weights should have shape"):
        WeightedSum([1, 1]).update(LINEARIZATION)
    for learner in (ConstraintSwitching([0, 0]), CPGRL(ConstrainedStep(), [0, 0])):
        with pytest.raises(ValueError, match=r"thresholds should have shape \(3,\)"):
            learner.update(LINEARIZATION)


# Gradient plus restoration: the same restoration as CPGRL's, the gradient whole. Both, one, none violated:
WITHOUT_P = Linearization(np.array([[1.0, -0.2, -0.3], [1.0, -0.2, 0.4], [1.0, 0.1, 0.2]]), GRADIENTS[:3, :3, :7])
STEP = ConstrainedStep(solver="rosen", step_size=0.5, restoration_rate=0.25, drop="never")


def test_the_change_is_the_whole_gradient_and_the_papers_restoration():
    update = GradientWithRestoration(STEP, [0, 0]).update(WITHOUT_P)
    for run, active in enumerate([[1, 2], [1], []]):
        expected = 0.5 * WITHOUT_P.gradients[run, 0]
        if active:
            expected = expected - 0.25 * restoration_move(
                WITHOUT_P.gradients[run, active], WITHOUT_P.values[run, active]
            )
        np.testing.assert_allclose(update.change[run], expected, rtol=1e-10)
    np.testing.assert_array_equal(update.active, WITHOUT_P.values[:, 1:] <= 0)


def test_safeguards_act_on_the_restoration_alone_and_are_counted():
    step = ConstrainedStep(max_restoration=1e-3, restoration_rate=0.25, step_size=0.5)
    update = GradientWithRestoration(step, [0, 0]).update(WITHOUT_P)
    restoration = update.change - 0.5 * WITHOUT_P.gradients[:, 0]
    assert (np.linalg.norm(restoration, axis=1) <= 1e-3 * (1 + 1e-9)).all()
    np.testing.assert_array_equal(update.counts["capped"], [1, 1, 0])
    assert not update.stationary.any()


def test_a_formulation_whose_restoration_is_no_move_of_its_own_is_refused():
    for formulation in ("restoring", "linearized"):
        with pytest.raises(ValueError, match=rf"formulation should be 'equality' or 'cone'.*found '{formulation}'"):
            GradientWithRestoration(ConstrainedStep(formulation=formulation), [0, 0])
