"""The step against closed forms and against the paper's formulas; every setting, every status, every safeguard."""

from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cpgrl_opt import (
    SOLVERS,
    ConstrainedStep,
    Direction,
    DirectionError,
    Linearization,
    Status,
    hysteresis,
    project_onto_tangent,
    restoration_move,
    tangent_multipliers,
    violated,
)

FORMULATION_NAMES = ["equality", "cone", "restoring"]
SEEDS = st.integers(0, 2**32 - 1)


def random_linearization(seed, m=3, n=9, runs=()):
    rng = np.random.default_rng(seed)
    return Linearization(rng.standard_normal((*runs, 1 + m)), rng.standard_normal((*runs, 1 + m, n)))


def plain(**settings):
    return ConstrainedStep(**{"step_size": 0.02, "restoration_rate": 0.05, "drop": "never", **settings})


@dataclass(frozen=True)
class Failing:
    """A solver that answers with one status and a useless direction."""

    status: Status

    def solve(self, problem):
        return Direction(np.full(problem.n, 7.0), np.zeros(problem.m), self.status)


@given(SEEDS)
def test_equality_is_the_papers_update(seed):
    """θ ← θ + α₁PΔ¹ − αₑd (eq. 8–10), the active set those with ρ ≤ G."""
    linearization, thresholds = random_linearization(seed), np.array([0.1, -0.2, 0.3])
    slack = linearization.slack(thresholds)
    rows = linearization.jacobian[slack <= 0]
    expected = 0.02 * project_onto_tangent(rows, linearization.objective_gradient)
    expected -= 0.05 * restoration_move(rows, slack[slack <= 0])
    np.testing.assert_allclose(plain()(linearization, thresholds).change, expected, atol=1e-13)


@pytest.mark.parametrize("formulation", FORMULATION_NAMES)
@given(seed=SEEDS)
def test_without_active_constraints_the_step_is_plain_gradient_ascent(formulation, seed):
    linearization = random_linearization(seed)
    result = plain(formulation=formulation)(linearization, np.full(3, -100.0))
    np.testing.assert_array_equal(result.change, 0.02 * linearization.objective_gradient)
    assert not result.active.any()


@given(seed=SEEDS)
def test_cone_and_restoring_meet_their_linearised_constraints(seed):
    linearization = random_linearization(seed)
    target = -np.minimum(linearization.slack(np.zeros(3)), 0.0)
    active = linearization.slack(np.zeros(3)) <= 0
    for formulation in ("cone", "restoring"):
        change = plain(formulation=formulation)(linearization, np.zeros(3)).change
        gained = linearization.jacobian @ change
        assert (gained >= 0.05 * target - 1e-12)[active].all()


@given(seed=SEEDS)
def test_the_single_restoring_qp_is_never_longer_in_error_than_cone_and_restoration_apart(seed):
    """Both meet the constraints; the QP is the nearest to α₁Δ¹ that does."""
    linearization = random_linearization(seed)
    goal = 0.02 * linearization.objective_gradient
    apart, inside = (plain(formulation=name)(linearization, np.zeros(3)).change for name in ("cone", "restoring"))
    assert np.linalg.norm(inside - goal) <= np.linalg.norm(apart - goal) + 1e-12


@pytest.mark.parametrize("formulation", FORMULATION_NAMES)
@pytest.mark.parametrize("scale", [1e-170, 1e-8, 1e8, 1e170])
def test_the_direction_does_not_depend_on_the_scale_of_the_gradients(formulation, scale):
    one = random_linearization(3)
    scaled = Linearization(np.zeros(4), scale * one.gradients)
    reference = plain(formulation=formulation)(Linearization(np.zeros(4), one.gradients), np.zeros(3)).change
    change = plain(formulation=formulation)(scaled, np.zeros(3)).change
    np.testing.assert_allclose(change / scale, reference, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("formulation", FORMULATION_NAMES)
def test_many_runs_at_once_are_the_same_runs_one_by_one(formulation):
    together = random_linearization(5, runs=(2, 4))
    result = plain(formulation=formulation)(together, np.zeros(3))
    assert result.change.shape == (2, 4, 9)
    for index in np.ndindex(2, 4):
        alone = plain(formulation=formulation)(
            Linearization(together.values[index], together.gradients[index]), np.zeros(3)
        )
        np.testing.assert_array_equal(result.change[index], alone.change)


@pytest.mark.parametrize("formulation", FORMULATION_NAMES)
def test_a_learner_without_constraints_climbs(formulation):
    result = plain(formulation=formulation)(random_linearization(0, m=0, runs=(2,)), [])
    np.testing.assert_array_equal(result.change, 0.02 * random_linearization(0, m=0, runs=(2,)).objective_gradient)


def test_slack_never_pushes_towards_the_boundary():
    """A rule with a margin activates a satisfied constraint; its restoration is 0, not −slack."""
    linearization = Linearization([0.0, 0.5], [[1.0, 1.0], [0.0, 1.0]])
    for formulation in ("equality", "cone", "restoring"):
        step = plain(formulation=formulation, rule=partial(violated, margin=1.0))
        assert step(linearization, [0.0]).change[1] >= 0.0


def test_a_solver_whose_tolerance_lets_anything_pass_makes_no_step():
    lenient = SimpleNamespace(solve=lambda p: Direction(p.gradient, np.zeros(p.m), Status.OPTIMAL), tolerance=10)
    with pytest.raises(ValueError, match="tolerance should be a number in"):
        plain(formulation="cone", solver=lenient)(random_linearization(0, m=2), [10.0, 10.0])


def test_a_margin_activates_constraints_up_to_it_and_a_negative_one_is_refused():
    slack = np.array([[-0.1, 0.0, 0.05], [0.1, 0.15, 1.0]])
    assert violated(slack).tolist() == [[True, True, False], [False, False, False]]
    assert violated(slack, margin=0.1).tolist() == [[True, True, True], [True, False, False]]
    with pytest.raises(ValueError, match=r"margin should be a number ≥ 0; found -0\.1"):
        violated(slack, margin=-0.1)


def test_a_step_with_a_margin_keeps_level_what_a_step_without_one_lets_fall():
    """g = (−1, 1) would lower what the constraint, met by 0.5, holds: its row is (1, 0)."""
    linearization = Linearization([0.0, 0.5], [[-1.0, 1.0], [1.0, 0.0]])
    for formulation in FORMULATION_NAMES:
        falls, stays = (
            plain(formulation=formulation, rule=partial(violated, margin=margin))(linearization, [0.0])
            for margin in (0.4, 0.6)
        )
        assert falls.change[0] < -1e-3
        assert abs(stays.change[0]) < 1e-12
        assert stays.change[1] > 1e-3


def test_hysteresis_keeps_a_constraint_until_it_has_left_its_band():
    rule = partial(hysteresis, enter=0.0, leave=0.1)
    active = rule(np.array([-0.1, 0.05, 0.05]), None)
    assert active.tolist() == [True, False, False]
    active = rule(np.array([0.05, 0.05, 0.2]), np.array([True, False, True]))
    assert active.tolist() == [True, False, False]
    with pytest.raises(ValueError, match="leave − enter should be a number ≥ 0"):
        hysteresis(np.zeros(1), enter=0.1, leave=0.0)


class TestDropRule:
    """§2.3: when PΔ¹ = 0, the constraint with the largest positive λ leaves the active set (sign as in slip 1)."""

    # n = 2 with two independent rows: PΔ¹ = 0. Δ¹ = row₁ + 2·row₂ in unit rows, so both λ are positive.
    LINEARIZATION = Linearization([0.0, -1.0, -1.0], [[1.0, 2.0], [1.0, 0.0], [0.0, 1.0]])

    def test_the_largest_multiplier_goes_and_both_p_and_d_are_built_anew(self):
        result = plain(drop="stationary")(self.LINEARIZATION, [0.0, 0.0])
        # row 2 (λ = 2) is dropped: P keeps the second axis, d restores only the first constraint
        np.testing.assert_allclose(result.change, [0.05, 0.04], atol=1e-15)
        assert result.counts["dropped"] == 1

    def test_never_leaves_the_restoration_only(self):
        result = plain(drop="never")(self.LINEARIZATION, [0.0, 0.0])
        np.testing.assert_allclose(result.change, [0.05, 0.05], atol=1e-15)
        assert result.counts["dropped"] == 0

    def test_always_goes_on_until_no_multiplier_is_positive(self):
        result = plain(drop="always")(self.LINEARIZATION, [0.0, 0.0])
        np.testing.assert_allclose(result.change, 0.02 * np.array([1.0, 2.0]), atol=1e-15)
        assert result.counts["dropped"] == 2

    def test_row_lengths_matter_only_to_the_raw_multipliers(self):
        gradients = self.LINEARIZATION.gradients * np.array([1.0, 1e-3, 1.0])[:, None]  # λ = (1000, 2)
        stretched = Linearization(self.LINEARIZATION.values, gradients)
        scaled, raw = (
            plain(drop="stationary", restoration_rate=0.0, raw_multipliers=raw)(stretched, [0.0, 0.0]).change
            for raw in (False, True)
        )
        np.testing.assert_allclose(scaled, [0.0, 0.04], atol=1e-15)
        np.testing.assert_allclose(raw, [0.02, 0.0], atol=1e-15)

    def test_a_constrained_optimum_is_reported_and_nothing_is_dropped(self):
        at_optimum = Linearization([0.0, 0.0], [[0.0, -1.0], [0.0, 1.0]])
        assert (tangent_multipliers(at_optimum.jacobian, at_optimum.objective_gradient) < 0).all()
        result = plain(drop="stationary")(at_optimum, [0.0])
        assert result.stationary
        assert result.counts["dropped"] == 0
        np.testing.assert_allclose(result.change, [0.0, 0.0], atol=1e-17)

    def test_a_positive_multiplier_is_no_optimum(self):
        climbing = Linearization([0.0, 0.0], [[0.0, 1.0], [0.0, 1.0]])
        assert not plain(drop="never")(climbing, [0.0]).stationary


class TestSafeguards:
    @pytest.mark.parametrize("formulation", FORMULATION_NAMES)
    def test_the_restoration_is_shortened_to_its_limit(self, formulation):
        tiny = Linearization([0.0, -1.0], [[1.0, 0.0], [0.0, 1e-6]])  # J⁺ slack = 1e6
        free = plain(formulation=formulation)(tiny, [0.0])
        held = plain(formulation=formulation, max_restoration=0.1)(tiny, [0.0])
        assert abs(free.change[1]) == pytest.approx(0.05 * 1e6)
        np.testing.assert_allclose(held.change, [0.02, 0.1], rtol=1e-12)
        assert (free.counts["capped"], held.counts["capped"]) == (0, 1)

    @given(seed=SEEDS)
    def test_the_ridge_is_the_regularised_inverse(self, seed):
        linearization, eps = random_linearization(seed), 0.3
        slack = linearization.slack(np.zeros(3))
        active = slack <= 0
        J, g = linearization.jacobian[active], linearization.objective_gradient
        inverse = np.linalg.inv(J @ J.T + eps * np.eye(len(J)))
        expected = 0.02 * (g - J.T @ inverse @ J @ g) - 0.05 * J.T @ inverse @ slack[active]
        np.testing.assert_allclose(plain(ridge=eps)(linearization, np.zeros(3)).change, expected, atol=1e-12)

    def test_the_ridge_bounds_the_restoration_of_a_tiny_gradient(self):
        tiny = Linearization([0.0, -1.0], [[1.0, 0.0], [0.0, 1e-8]])
        assert abs(plain(ridge=1e-4)(tiny, [0.0]).change[1]) < 1e-3

    @pytest.mark.parametrize("metric", [None, [1.0, 4.0]])
    @pytest.mark.parametrize("formulation", FORMULATION_NAMES)
    def test_a_limit_on_the_restoration_counts_what_moves_the_parameters_and_not_the_ridge(self, formulation, metric):
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
    FAILED = (Status.UNCERTIFIED, Status.ITERATION_LIMIT, Status.NUMERICAL_ERROR, Status.UNSUPPORTED)

    @pytest.mark.parametrize("status", FAILED)
    def test_a_failure_falls_back_to_the_exact_solver_and_is_counted(self, status):
        result = plain(solver=Failing(status))(self.LINEARIZATION, [0.0])
        np.testing.assert_allclose(result.change, plain()(self.LINEARIZATION, [0.0]).change, atol=1e-15)
        assert result.counts["fallback"] == 2  # tangent and restoration

    @pytest.mark.parametrize("status", FAILED)
    def test_a_failure_can_be_skipped(self, status):
        result = plain(solver=Failing(status), on_failure="skip")(self.LINEARIZATION, [0.0])
        assert not result.change.any()
        assert result.counts["skipped"] == 1  # one update, whichever of its subproblems failed
        assert not result.stationary

    @pytest.mark.parametrize("status", FAILED)
    def test_a_failure_can_be_raised_with_its_advice(self, status):
        with pytest.raises(DirectionError, match=status.name):
            plain(solver=Failing(status), on_failure="raise")(self.LINEARIZATION, [0.0])

    def test_an_infeasible_subproblem_is_used_and_counted(self):
        opposing = Linearization([0.0, -1.0, -1.0], [[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        for formulation, change in (("equality", [0.02, 0.0]), ("cone", [0.02, 0.0]), ("restoring", [0.02, 0.0])):
            result = plain(formulation=formulation)(opposing, [0.0, 0.0])
            np.testing.assert_allclose(result.change, change, atol=1e-14)
            assert result.counts["infeasible"] == 1
            assert result.counts["fallback"] == 0

    def test_an_active_constraint_without_gradient_is_left_out_and_counted(self):
        flat = Linearization([0.0, -1.0, -1.0], [[1.0, 1.0], [0.0, 0.0], [0.0, 1.0]])
        alone = Linearization([0.0, -1.0], [[1.0, 1.0], [0.0, 1.0]])
        for formulation in FORMULATION_NAMES:
            result = plain(formulation=formulation)(flat, [0.0, 0.0])
            np.testing.assert_array_equal(result.change, plain(formulation=formulation)(alone, [0.0]).change)
            assert (result.counts["flat"], result.counts["infeasible"]) == (1, 0)
            assert result.active.all()

    def test_a_ridge_is_counted_where_it_acts(self):
        both = Linearization([[0.0, -1.0], [0.0, 1.0]], np.stack([self.LINEARIZATION.gradients] * 2))
        assert plain(ridge=1e-3)(both, [0.0]).counts["softened"].tolist() == [1, 0]
        assert plain()(both, [0.0]).counts["softened"].tolist() == [0, 0]

    def test_one_failing_run_does_not_touch_the_others(self):
        both = Linearization([[0.0, -1.0], [0.0, 1.0]], np.stack([self.LINEARIZATION.gradients] * 2))
        result = plain(solver=Failing(Status.UNCERTIFIED))(both, [0.0])
        assert result.counts["fallback"].tolist() == [2, 2]


@pytest.mark.parametrize("name", ["rosen", "active-set", "nnls", "enumeration"])
def test_every_exact_solver_gives_the_same_step(name):
    linearization = random_linearization(8, runs=(6,))
    reference = plain(solver="active-set")(linearization, np.zeros(3))
    np.testing.assert_allclose(plain(solver=name)(linearization, np.zeros(3)).change, reference.change, atol=1e-12)


def test_an_observer_sees_every_subproblem_with_its_answer():
    seen = []
    step = plain(solver=SOLVERS["active-set"])
    step(
        random_linearization(2, runs=(4,)),
        np.zeros(3),
        observe=lambda problems, answers: seen.append((problems, answers)),
    )
    problems, answers = seen[0]
    assert len(seen) == 1
    assert len(problems) == len(answers) == 8


@pytest.mark.parametrize("solver", ["active-set", "rosen"])
@pytest.mark.parametrize("formulation", ["equality", "cone", "restoring", "linearized"])
@pytest.mark.parametrize("runs", [(), (1,), (20,), (2, 3)])
def test_the_usual_way_in_one_compiled_call_gives_the_bits_of_the_long_way(runs, formulation, solver):
    """An observer is told of each subproblem, which the one call does not do."""
    rng = np.random.default_rng(5)
    step = ConstrainedStep(solver=solver, formulation=formulation)
    for trial in range(12):
        m = 1 + trial % 4
        gradients = rng.standard_normal((*runs, 1 + m, 7))
        if trial % 3 == 1:
            gradients[..., -1, :] = gradients[..., 1, :]  # rows that depend
        if trial % 3 == 2:
            gradients[..., 1, :] *= rng.choice([0.0, 1e-3, 1e200])  # flat or extreme rows
        linearization = Linearization(0.1 * rng.standard_normal((*runs, 1 + m)), gradients)
        direct = step(linearization, np.zeros(m))
        watched = step(linearization, np.zeros(m), observe=lambda *_: None)
        assert direct.change.tobytes() == watched.change.tobytes()
        assert direct.change.shape == (*gradients.shape[:-2], 7)
        assert (direct.active == watched.active).all()
        assert (direct.stationary == watched.stationary).all()
        assert direct.stationary.shape == runs
        for name, size in (("multipliers", m), ("residuals", 4), ("predicted_slack", m)):
            assert getattr(direct, name).shape == (*runs, size)
            np.testing.assert_array_equal(getattr(direct, name), getattr(watched, name))
        assert {name: count.tolist() for name, count in direct.counts.items()} == {
            name: count.tolist() for name, count in watched.counts.items()
        }
