"""What a step says of itself: multipliers, residuals and predicted slack prove its change, by whatever way it came."""

import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cpgrl_opt import ConstrainedStep, Direction, Linearization, Status, StepResult
from cpgrl_opt.vectors import _numpy as array_vectors

FORMULATIONS = ["equality", "cone", "restoring", "linearized"]
METRIC = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 3.0]])
WAYS = {
    "usual": {},
    "by a QP": {"solver": "quadprog"},
    "metric": {"metric": METRIC},
    "radius": {"radius": 0.3, "step_size": 0.02},
}


def drawn(seed, m, runs=(), n=3):
    rng = np.random.default_rng(seed)
    return Linearization(0.1 * rng.standard_normal((*runs, 1 + m)), rng.standard_normal((*runs, 1 + m, n)))


def proven(step, linearization, result, thresholds, error=1e-9):
    """α₁ s = change − αₑ v is along M⁻¹(g + Jᵀμ), μ ≥ 0 but for equalities; J change leads to the predicted slack."""
    J, slack = linearization.jacobian, linearization.slack(thresholds)
    np.testing.assert_allclose(result.predicted_slack, slack + J @ result.change, atol=1e-12)
    assert (result.multipliers[~result.active] == 0.0).all()
    assert (result.residuals <= step.solver.tolerance).all()
    if step.formulation != "equality":
        assert (result.multipliers >= 0.0).all()
    if step.restoration_rate == 0.0:
        M = np.eye(J.shape[1]) if step.metric is None else step.metric
        s = np.linalg.solve(M, linearization.objective_gradient + J.T @ result.multipliers)
        if step.radius is not None:
            s *= step.radius / np.sqrt(s @ M @ s)
        np.testing.assert_allclose(result.change, step.step_size * s, atol=error)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("formulation", FORMULATIONS)
@given(seed=st.integers(0, 2**32 - 1), m=st.integers(0, 2), rate=st.sampled_from([0.0, 0.05]))
def test_a_step_proves_its_change(formulation, way, seed, m, rate):
    linearization, thresholds = drawn(seed, m), np.zeros(m)
    step = ConstrainedStep(formulation=formulation, drop="never", restoration_rate=rate, **WAYS[way])
    result = step(linearization, thresholds)
    if not result.counts["infeasible"]:  # out of the ball's reach
        proven(step, linearization, result, thresholds)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_long_gradients_are_proven_too(monkeypatch, formulation):
    """Of constraints that are not active too, of which their coordinates know nothing."""
    monkeypatch.setattr(array_vectors, "LEAST_PRODUCTS", 0)
    step = ConstrainedStep(formulation=formulation, drop="never", restoration_rate=0.0)
    for seed in range(5):
        linearization = drawn(seed, 3, n=120)
        assert linearization.is_long
        proven(step, linearization, step(linearization, np.zeros(3)), np.zeros(3))
    runs = step(drawn(0, 3, runs=(2, 3), n=120), np.zeros(3))
    assert (runs.multipliers.shape, runs.residuals.shape) == ((2, 3, 3), (2, 3, 4))
    none = step(drawn(0, 3, runs=(0,), n=120), np.zeros(3))
    assert (none.multipliers.shape, none.residuals.shape, none.predicted_slack.shape) == ((0, 3), (0, 4), (0, 3))


def test_residuals_are_the_worst_of_tangent_and_restoration():
    """Of an answer that is off by 1e-4 of the restoration, by a solver that allows it."""

    class Sloppy:
        tolerance = 1e-3

        def solve(self, problem):
            answer = ConstrainedStep().solver.solve(problem)
            scale = 1.0 if problem.gradient.any() else 1.0 + 1e-4
            return Direction(scale * answer.value, answer.multipliers, answer.status)

    result = ConstrainedStep(solver=Sloppy())(drawn(3, 2), [1.0, 1.0])
    assert 1e-5 < result.residuals.max() < 1e-3
    assert result.residuals[2] == 0.0  # dual


def test_an_infeasible_subproblem_has_a_proof_and_no_residuals():
    opposed = Linearization([0.0, -1.0, -1.0], [[1.0, 1.0], [1.0, 0.0], [-1.0, 0.0]])
    result = ConstrainedStep(formulation="restoring")(opposed, [0.0, 0.0])
    y = result.multipliers
    assert (y > 0).all()
    np.testing.assert_allclose(opposed.jacobian.T @ y, 0.0, atol=1e-12)
    assert np.isnan(result.residuals).all()
    np.testing.assert_allclose(result.predicted_slack, [-1.0, -1.0])


def test_one_infeasible_run_leaves_the_others_their_residuals():
    opposed = [[1.0, 1.0], [1.0, 0.0], [-1.0, 0.0]]
    runs = Linearization([[0.0, -1.0, -1.0], [0.0, -1.0, 2.0]], [opposed, opposed])
    residuals = ConstrainedStep(formulation="restoring")(runs, [0.0, 0.0]).residuals
    assert np.isnan(residuals[0]).all()
    assert (residuals[1] <= 1e-12).all()


def test_a_skipped_run_claims_nothing():
    class Failing:
        def solve(self, problem):
            return Direction(np.ones(problem.n), np.ones(problem.m), Status.NUMERICAL_ERROR)

    result = ConstrainedStep(solver=Failing(), on_failure="skip")(drawn(0, 2), [1.0, 1.0])
    assert not result.change.any()
    assert not result.multipliers.any()
    assert np.isnan(result.residuals).all()
    np.testing.assert_array_equal(result.predicted_slack, drawn(0, 2).slack(np.ones(2)))


def test_a_dropped_constraint_has_no_multiplier():
    """Δ¹ climbs the second constraint by itself."""
    linearization = Linearization([0.0, -1.0, -1.0], [[-1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    result = ConstrainedStep(drop="always", restoration_rate=0.0)(linearization, [0.0, 0.0])
    assert result.counts["dropped"] == 1
    np.testing.assert_allclose(result.multipliers, [1.0, 0.0])


@pytest.mark.parametrize("scale", [1e-160, 1e160])
def test_extreme_rows_have_the_multipliers_of_the_rows_as_given(scale):
    linearization = Linearization([0.0, -1.0], [[-1.0, 1.0], [scale, 0.0]])
    result = ConstrainedStep(formulation="cone")(linearization, [0.0])
    np.testing.assert_allclose(result.multipliers, [1.0 / scale])


def test_results_of_before_stay_valid():
    """Made of four fields, and pickled when there were no others."""
    result = StepResult(np.zeros(2), np.array([True]), np.array(False), {})
    assert result.multipliers is None
    old = object.__new__(StepResult)
    vars(old).update(change=np.zeros(2), active=np.array([True]), stationary=np.array(False), counts={})
    assert pickle.loads(pickle.dumps(old)).predicted_slack is None
    assert dataclasses.replace(old, change=np.ones(2)).residuals is None
