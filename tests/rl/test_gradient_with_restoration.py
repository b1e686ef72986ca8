"""Gradient plus restoration, without P: the same restoration as CPGRL's, the gradient whole."""

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep, Linearization, projection_matrix, restoration_move
from rl import CPGRL, GradientWithRestoration

RNG = np.random.default_rng(0)
GRADIENTS = RNG.normal(size=(3, 3, 7))
VALUES = np.array([[1.0, -0.2, -0.3], [1.0, -0.2, 0.4], [1.0, 0.1, 0.2]])  # both, one, none violated
LINEARIZATION = Linearization(VALUES, GRADIENTS)
STEP = ConstrainedStep(solver="rosen", step_size=0.5, restoration_rate=0.25, drop="never")


def test_the_change_is_the_whole_gradient_and_the_papers_restoration():
    update = GradientWithRestoration(STEP, [0, 0]).update(LINEARIZATION)
    for run, active in enumerate([[1, 2], [1], []]):
        expected = 0.5 * GRADIENTS[run, 0]
        if active:
            expected = expected - 0.25 * restoration_move(GRADIENTS[run, active], VALUES[run, active])
        np.testing.assert_allclose(update.change[run], expected, rtol=1e-10)
    np.testing.assert_array_equal(update.active, VALUES[:, 1:] <= 0)


def test_it_differs_from_cpgrl_by_what_the_projection_takes_away():
    whole = GradientWithRestoration(STEP, [0, 0]).update(LINEARIZATION).change
    projected = CPGRL(STEP, [0, 0]).update(LINEARIZATION).change
    removed = 0.5 * (np.eye(7) - projection_matrix(GRADIENTS[0, 1:])) @ GRADIENTS[0, 0]
    np.testing.assert_allclose(whole[0] - projected[0], removed, atol=1e-12)
    np.testing.assert_allclose(whole[2], projected[2], atol=1e-15)


@pytest.mark.parametrize("formulation", ["equality", "cone"])
def test_safeguards_act_on_the_restoration_alone_and_are_counted(formulation):
    step = ConstrainedStep(formulation=formulation, max_restoration=1e-3, restoration_rate=0.25, step_size=0.5)
    update = GradientWithRestoration(step, [0, 0]).update(LINEARIZATION)
    restoration = update.change - 0.5 * GRADIENTS[:, 0]
    assert (np.linalg.norm(restoration, axis=1) <= 1e-3 * (1 + 1e-9)).all()
    np.testing.assert_array_equal(update.counts["capped"], [1, 1, 0])
    assert not update.stationary.any()


def test_a_formulation_whose_restoration_is_no_move_of_its_own_is_refused():
    for formulation in ("restoring", "linearized"):
        with pytest.raises(ValueError, match=rf"formulation should be 'equality' or 'cone'.*found '{formulation}'"):
            GradientWithRestoration(ConstrainedStep(formulation=formulation), [0, 0])
