"""The step against closed forms and the paper's formulas; every setting, every status, every safeguard."""

import dataclasses
import pickle
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cpgrl_opt import (
    ConstrainedStep,
    Direction,
    DirectionError,
    Linearization,
    Status,
    StepResult,
    hysteresis,
    project_onto_tangent,
    restoration_move,
    violated,
)

from .steps import ACTIVE_ONLY, FORMULATIONS, Claiming, drawn, plain

SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS)
def test_equality_is_the_papers_update(seed):
    """θ ← θ + α₁PΔ¹ − αₑd (eq. 8–10), the active set those with ρ ≤ G."""
    linearization, thresholds = drawn(seed, n=9), np.array([0.1, -0.2, 0.3])
    slack = linearization.slack(thresholds)
    rows = linearization.jacobian[slack <= 0]
    expected = 0.02 * project_onto_tangent(rows, linearization.objective_gradient)
    expected -= 0.05 * restoration_move(rows, slack[slack <= 0])
    np.testing.assert_allclose(plain()(linearization, thresholds).change, expected, atol=1e-13)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@given(seed=SEEDS, m=st.sampled_from([0, 3]))
def test_without_active_constraints_the_step_is_plain_gradient_ascent(formulation, seed, m):
    linearization = drawn(seed, m)
    result = plain(formulation=formulation)(linearization, np.full(m, -100.0))
    np.testing.assert_array_equal(result.change, 0.02 * linearization.objective_gradient)
    assert not result.active.any()


@given(seed=SEEDS)
def test_cone_and_restoring_meet_their_constraints_and_the_single_qp_is_nearer_to_the_gradient(seed):
    linearization = drawn(seed, n=9)
    goal, slack = 0.02 * linearization.objective_gradient, linearization.values[1:]
    apart, inside = (plain(formulation=name)(linearization, np.zeros(3)).change for name in ("cone", "restoring"))
    for change in (apart, inside):
        assert (linearization.jacobian @ change >= -0.05 * slack - 1e-12)[slack <= 0].all()
    assert np.linalg.norm(inside - goal) <= np.linalg.norm(apart - goal) + 1e-12


def test_rules_activate_constraints_up_to_their_margin_and_keep_them_within_their_band():
    slack = np.array([[-0.1, 0.0, 0.05], [0.1, 0.15, 1.0]])
    assert violated(slack).tolist() == [[True, True, False], [False, False, False]]
    assert violated(slack, margin=0.1).tolist() == [[True, True, True], [True, False, False]]
    rule = partial(hysteresis, enter=0.0, leave=0.1)
    assert rule(np.array([-0.1, 0.05, 0.05]), None).tolist() == [True, False, False]
    assert rule(np.array([0.05, 0.05, 0.2]), np.array([True, False, True])).tolist() == [True, False, False]


class TestDropRule:
    """§2.3: when PΔ¹ = 0, the constraint with the largest positive λ leaves the active set (sign as in slip 1)."""

    # n = 2 with two independent rows: PΔ¹ = 0. Δ¹ = row₁ + 2·row₂ in unit rows, so both λ are positive.
    LINEARIZATION = Linearization([0.0, -1.0, -1.0], [[1.0, 2.0], [1.0, 0.0], [0.0, 1.0]])

    @pytest.mark.parametrize(
        ("drop", "change", "count"),
        [
            ("stationary", [0.05, 0.04], 1),  # row 2 (λ = 2) goes: P keeps the second axis, d restores the first row
            ("never", [0.05, 0.05], 0),  # restoration only
            ("always", [0.02, 0.04], 2),  # until no multiplier is positive
        ],
    )
    def test_what_leaves_and_both_p_and_d_built_anew(self, drop, change, count):
        result = plain(drop=drop)(self.LINEARIZATION, [0.0, 0.0])
        np.testing.assert_allclose(result.change, change, atol=1e-15)
        assert result.counts["dropped"] == count
        assert np.count_nonzero(result.multipliers) == 2 - count


class TestRestoration:
    # Two rows that nearly oppose each other are met far away; J⁺ answers by least squares, and is short.
    ROWS = ((0.0, 1.0), (1.0, 0.01), (-1.0, 0.01))
    STILL = Linearization([0.0, -1.0, -1.0, -1.0], [[0.0, 0.0], *ROWS])

    @pytest.mark.parametrize("metric", [None, [4.0, 0.25]])
    @pytest.mark.parametrize("formulation", FORMULATIONS)
    def test_it_is_shortened_to_its_limit_and_keeps_its_direction(self, formulation, metric):
        free, held = (
            plain(formulation=formulation, metric=metric, restoration_rate=1.0, max_restoration=limit)(
                self.STILL, [0.0, 0.0, 0.0]
            )
            for limit in (np.inf, 0.1)
        )
        lengths = np.sqrt(np.broadcast_to(1.0 if metric is None else metric, 2))
        size, unlimited = (np.linalg.norm(each.change * lengths) for each in (held, free))
        assert (free.counts["capped"], held.counts["capped"]) == (0, 1)
        assert size <= 0.1 * (1 + 1e-12)
        if formulation != "equality":  # no shorter than need be
            assert size == pytest.approx(0.1)
            np.testing.assert_allclose(held.change, free.change * size / unlimited, rtol=1e-9, atol=1e-15)

    @pytest.mark.parametrize("formulation", ["cone", "restoring"])
    def test_the_formula_with_the_pseudo_inverse_holds_too(self, formulation):
        """J⁺ restores to equality what v exceeds: v = (0, 1) meets 1 and 0.9 alike, J⁺ needs a sideways move."""
        both = Linearization([0.0, -1.0, -0.5], [[0.0, 0.0], [0.0, 1.0], [0.1, 1.0]])
        printed = np.linalg.norm(restoration_move(both.jacobian, both.values[1:]))
        free, held = (
            plain(formulation=formulation, restoration_rate=1.0, max_restoration=limit)(both, [0.0, 0.0]).change
            for limit in (np.inf, 1.0)
        )
        np.testing.assert_allclose(held, free / printed)

    @given(seed=SEEDS)
    def test_the_ridge_is_the_regularised_inverse(self, seed):
        linearization, eps = drawn(seed, n=9), 0.3
        slack = linearization.values[1:]
        active = slack <= 0
        J, g = linearization.jacobian[active], linearization.objective_gradient
        inverse = np.linalg.inv(J @ J.T + eps * np.eye(len(J)))
        expected = 0.02 * (g - J.T @ inverse @ J @ g) - 0.05 * J.T @ inverse @ slack[active]
        result = plain(ridge=eps)(linearization, np.zeros(3))
        np.testing.assert_allclose(result.change, expected, atol=1e-12)
        assert result.counts["softened"] == active.any()
        assert plain()(linearization, np.zeros(3)).counts["softened"] == 0

    @pytest.mark.parametrize("metric", [None, [1.0, 4.0]])
    @pytest.mark.parametrize("formulation", ACTIVE_ONLY)
    def test_its_limit_counts_what_moves_the_parameters_and_not_the_ridge(self, formulation, metric):
        linearization = Linearization([0.0, -0.3], [[1.0, 0.0], [0.0, 1e-3]])
        weight = 1.0 if metric is None else metric[1]
        moved = 0.05 * 0.3 * 1e-3 / weight / (1e-6 / weight + 1e-4)  # αₑ M⁻¹Jᵀ(JM⁻¹Jᵀ + ε)⁻¹ t
        size = moved * np.sqrt(weight)
        settings = {"formulation": formulation, "ridge": 1e-4, "metric": metric}
        free = plain(**settings, max_restoration=1.01 * size)(linearization, [0.0])
        held = plain(**settings, max_restoration=size / 2)(linearization, [0.0])
        assert (free.counts["capped"], held.counts["capped"]) == (0, 1)
        np.testing.assert_allclose([free.change[1], held.change[1]], [moved, moved / 2], rtol=1e-9)


class TestStatuses:
    LINEARIZATION = Linearization([0.0, -1.0], [[1.0, 1.0], [0.0, 1.0]])
    OPPOSED = Linearization([0.0, -1.0, -1.0], [[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])

    @pytest.mark.parametrize("status", [Status.UNCERTIFIED, Status.UNSUPPORTED])
    def test_a_failure_falls_back_to_the_exact_solver_or_is_skipped_or_raised(self, status):
        failing = Claiming(7.0, status)
        result = plain(solver=failing)(self.LINEARIZATION, [0.0])
        np.testing.assert_allclose(result.change, plain()(self.LINEARIZATION, [0.0]).change, atol=1e-15)
        assert result.counts["fallback"] == 2  # tangent and restoration
        skipped = plain(solver=failing, on_failure="skip")(self.LINEARIZATION, [0.0])
        assert not skipped.change.any()
        assert skipped.counts["skipped"] == 1  # one update, whichever of its subproblems failed
        assert not skipped.stationary
        assert not skipped.multipliers.any()
        assert np.isnan(skipped.residuals).all()
        np.testing.assert_array_equal(skipped.predicted_slack, [-1.0])
        with pytest.raises(DirectionError, match=status.name):
            plain(solver=failing, on_failure="raise")(self.LINEARIZATION, [0.0])

    @pytest.mark.parametrize("formulation", FORMULATIONS)
    def test_an_infeasible_subproblem_is_used_and_counted_and_leaves_others_alone(self, formulation):
        runs = Linearization([self.OPPOSED.values, [0.0, -1.0, 2.0]], [self.OPPOSED.gradients] * 2)
        result = plain(formulation=formulation)(runs, [0.0, 0.0])
        np.testing.assert_allclose(result.change[0], [0.02, 0.0], atol=1e-14)
        assert result.counts["infeasible"].tolist() == [1, 0]
        assert not result.counts["fallback"].any()
        assert np.isnan(result.residuals[0]).all()
        assert (result.residuals[1] <= 1e-12).all()
        np.testing.assert_allclose(result.predicted_slack[0], [-1.0, -1.0])
        if formulation == "restoring":  # whose multipliers are the proof
            assert (result.multipliers[0] > 0).all()
            np.testing.assert_allclose(self.OPPOSED.jacobian.T @ result.multipliers[0], 0.0, atol=1e-12)

    def test_an_active_constraint_without_gradient_is_left_out_and_counted(self):
        flat = Linearization([0.0, -1.0, -1.0], [[1.0, 1.0], [0.0, 0.0], [0.0, 1.0]])
        for formulation in ACTIVE_ONLY:
            result, alone = (
                plain(formulation=formulation)(each, 0.0 * each.values[1:]) for each in (flat, self.LINEARIZATION)
            )
            np.testing.assert_array_equal(result.change, alone.change)
            assert (result.counts["flat"], result.counts["infeasible"]) == (1, 0)
            assert result.active.all()

    def test_residuals_are_the_worst_of_tangent_and_restoration(self):
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


def test_an_observer_sees_every_subproblem_with_its_answer_and_keeps_what_it_saw():
    seen = []
    plain(drop="always")(
        drawn(2, runs=(4,)),
        np.zeros(3),
        observe=lambda problems, answers: seen.append((problems, answers, answers.value.copy())),
    )
    assert len(seen[0][0]) == len(seen[0][1]) == 8
    for _, answers, value in seen:
        np.testing.assert_array_equal(answers.value, value)


def test_results_of_before_stay_valid():
    """Made of four fields, and pickled when there were no others."""
    result = StepResult(np.zeros(2), np.array([True]), np.array(False), {})
    assert result.multipliers is None
    old = object.__new__(StepResult)
    vars(old).update(change=np.zeros(2), active=np.array([True]), stationary=np.array(False), counts={})
    assert pickle.loads(pickle.dumps(old)).predicted_slack is None
    assert dataclasses.replace(old, change=np.ones(2)).residuals is None
