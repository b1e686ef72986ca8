"""`max_restoration` holds for the restoration that is really made, where rows depend too."""

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep, Linearization, restoration_move

LIMIT, THRESHOLDS = 0.1, [0.0, 0.0, 0.0]
# Two rows that nearly oppose each other are met far away; J⁺ answers by least squares, and is short.
ROWS = [[0.0, 1.0], [1.0, 0.01], [-1.0, 0.01]]
STILL = Linearization([0.0, -1.0, -1.0, -1.0], [[0.0, 0.0], *ROWS])


def held(formulation, limit=LIMIT, **settings):
    rates = {"step_size": 0.5, "restoration_rate": 1.0, "drop": "never"}
    return ConstrainedStep(formulation=formulation, max_restoration=limit, **{**rates, **settings})


@pytest.mark.parametrize("metric", [None, [4.0, 0.25]])
@pytest.mark.parametrize("formulation", ["equality", "cone", "restoring", "linearized"])
def test_the_move_is_no_longer_than_its_limit(formulation, metric):
    result = held(formulation, metric=metric)(STILL, THRESHOLDS)
    size = np.linalg.norm(result.change * np.sqrt(np.broadcast_to(1.0 if metric is None else metric, 2)))
    assert size <= LIMIT * (1 + 1e-12)
    assert result.counts["capped"] == 1
    if formulation != "equality":  # no shorter than need be
        assert size == pytest.approx(LIMIT)


@pytest.mark.parametrize("formulation", ["cone", "restoring"])
def test_a_shortened_restoration_keeps_its_direction(formulation):
    free = held(formulation, np.inf)(STILL, THRESHOLDS).change
    np.testing.assert_allclose(
        held(formulation)(STILL, THRESHOLDS).change, free * LIMIT / np.linalg.norm(free), atol=1e-15
    )


@pytest.mark.parametrize("formulation", ["cone", "restoring"])
def test_the_formula_with_the_pseudo_inverse_holds_too(formulation):
    """J⁺ restores to equality what v exceeds: v = (0, 1) meets 1 and 0.9 alike, J⁺ needs a sideways move."""
    both = Linearization([0.0, -1.0, -0.5], [[0.0, 0.0], [0.0, 1.0], [0.1, 1.0]])
    printed = np.linalg.norm(restoration_move(both.jacobian, both.values[1:]))
    free, result = (held(formulation, limit)(both, [0.0, 0.0]).change for limit in (np.inf, 1.0))
    np.testing.assert_allclose(result, free / printed)


def test_a_limit_on_one_run_does_not_touch_the_others():
    runs = Linearization([STILL.values, 0.01 * STILL.values], [STILL.gradients, [[1.0, 2.0], *np.eye(3, 2)]])
    for formulation in ("equality", "cone", "restoring"):
        result = held(formulation)(runs, THRESHOLDS)
        assert result.counts["capped"].tolist() == [1, 0]
