"""`linearized`: all constraints in one problem, CPO for any number of them, and a recovery in two stages."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from cpgrl_opt import DirectionProblem, Linearization, Status
from cpgrl_opt.published import CPO

from .steps import drawn, full

SEEDS = st.integers(0, 2**32 - 1)
METRIC = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 3.0]])


def test_its_problem_has_every_constraint_with_a_part_of_its_slack():
    """b = −κ slack/α₁ where slack ≥ 0, −αₑ slack/α₁ where it is not; a row of zeros is left out."""
    V = np.vstack([[1.0, 2.0], np.eye(2), [1.0, 1.0], [0.0, 0.0]])
    runs = Linearization([[0.0, 0.4, -0.2, 0.0, -1.0], [0.0, 1.0, 1.0, 1.0, 1.0]], [V, V])
    seen = []
    step = full(step_size=0.5, restoration_rate=0.1, slack_fraction=0.25)
    result = step(runs, np.zeros(4), observe=lambda problems, answers: seen.append((problems, answers)))
    [(problems, answers)] = seen
    np.testing.assert_allclose(problems.bound, [[-0.2, 0.04, 0.0, -np.inf], [-0.5, -0.5, -0.5, -np.inf]])
    assert not problems.equality.any()
    np.testing.assert_array_equal(result.change, 0.5 * answers.value)
    np.testing.assert_array_equal(result.active, answers.multipliers > 0)
    assert result.counts["flat"].tolist() == [1, 1]


@settings(max_examples=50)
@given(
    seed=SEEDS,
    m=st.integers(0, 4),
    kappa=st.floats(0.0, 1.0),
    rate=st.floats(0.0, 1.0),
    radius=st.sampled_from([None, 0.3]),
)
def test_no_constraint_loses_more_than_its_part_and_violations_shrink_by_theirs(seed, m, kappa, rate, radius):
    linearization = drawn(seed, m)
    step = full(step_size=0.02, slack_fraction=kappa, restoration_rate=rate, radius=radius)
    result, slack = step(linearization, np.zeros(m)), linearization.values[1:]
    if not result.counts["infeasible"]:
        left = np.where(slack < 0.0, 1.0 - rate, 1.0 - kappa) * slack
        assert (result.predicted_slack >= left - 1e-9).all()
        assert (result.residuals <= 1e-9).all()


@settings(max_examples=40)
@given(
    seed=SEEDS, branch=st.sampled_from(["satisfied", "violated", "recovery"]), metric=st.sampled_from([None, METRIC])
)
def test_with_one_constraint_it_is_constrained_policy_optimization(seed, branch, metric):
    """κ = α₁ = αₑ = 1 and a radius, against the closed form, on both sides of what the ball reaches."""
    rng = np.random.default_rng(seed)
    g, row, radius = rng.standard_normal(3), rng.standard_normal((1, 3)), 10.0 ** rng.uniform(-2, 1)
    reach = radius * np.sqrt(row[0] @ (row[0] if metric is None else np.linalg.solve(metric, row[0])))
    part = {"satisfied": rng.uniform(0, 2), "violated": -rng.uniform(0, 0.99), "recovery": -rng.uniform(1.01, 3)}
    slack = part[branch] * reach
    result = full(radius=radius, metric=metric)(Linearization([0.0, slack], np.vstack([g, row])), [0.0])
    cpo = CPO().solve(DirectionProblem(g, row, -slack, metric=metric, radius=radius))
    assert (cpo.status == Status.INFEASIBLE) == (branch == "recovery") == bool(result.counts["infeasible"])
    np.testing.assert_allclose(result.change, cpo.value, rtol=1e-9, atol=1e-9 * radius)
    assert (result.active[0], bool(result.counts["skipped"])) == (bool(cpo.multipliers[0] > 0), False)


def require_recovery(J, slack, kappa, g, d, radius=None):
    """v = (b̂ − Ĵd)₊ is least: Ĵ_Vᵀv + Ĵ_Sᵀy_S = λd with y_S ≥ 0, λ ≥ 0 on active rows; d is the best of these."""
    size = np.linalg.norm(J, axis=1)
    rows, bound = J / size[:, None], np.where(slack < 0.0, -slack, -kappa * slack) / size
    gives, lack = bound > 0.0, bound - rows @ d
    unit = max(bound.max(), np.linalg.norm(d))
    v = np.where(gives, np.maximum(lack, 0.0), 0.0)
    assert (lack[~gives] <= 1e-9 * unit).all()
    on_sphere = radius is not None and np.linalg.norm(d) >= radius * (1 - 1e-9)
    ball = [-d[:, None] / np.linalg.norm(d)] if on_sphere else []
    pushing = np.hstack([rows[~gives & (np.abs(lack) <= 1e-8 * unit)].T, *ball])
    weights, rest = nnls(pushing, -rows.T @ v) if pushing.size else (np.zeros(1), np.linalg.norm(rows.T @ v))
    assert rest <= 1e-7 * np.linalg.norm(v)
    if on_sphere and weights[-1] > 1e-6 * np.linalg.norm(v):
        return  # the only one
    face = rows[np.abs(np.where(gives, v - lack, lack)) <= 1e-7 * unit].T
    face = np.hstack([face, *ball])
    target = d - g if radius is None else -g
    assert (nnls(face, target)[1] if face.size else np.linalg.norm(target)) <= 1e-6 * np.linalg.norm(g)


@pytest.mark.parametrize("kind", ["generic", "sum", "opposed"])
@settings(max_examples=40)
@given(
    seed=SEEDS, m=st.integers(2, 5), n=st.integers(1, 4), kappa=st.sampled_from([0.0, 0.3, 1.0]), in_ball=st.booleans()
)
def test_what_contradicts_itself_is_violated_least_while_the_others_are_met(kind, seed, m, n, kappa, in_ball):
    radius = 10.0 ** np.random.default_rng(seed).uniform(-2, 1) if in_ball else None
    linearization = drawn(seed, m, n, kind)
    result, slack = full(slack_fraction=kappa, radius=radius)(linearization, np.zeros(m)), linearization.values[1:]
    assert not result.counts["skipped"]
    assert not result.counts["fallback"]
    if result.counts["infeasible"]:
        J, y = linearization.jacobian, result.multipliers
        require_recovery(J, slack, kappa, linearization.objective_gradient, result.change, radius)
        assert (y >= 0.0).all()
        gained = np.where(slack < 0.0, -slack, -kappa * slack) @ y
        force = np.linalg.norm(J.T @ y)
        assert gained > (0.0 if radius is None else radius * force)
        assert radius is not None or force <= 1e-7 * (np.linalg.norm(J, axis=1) @ y)
        np.testing.assert_array_equal(result.active, y > 0.0)


def test_the_others_are_met_before_anything_is_shared():
    """d ≥ 1 against d ≤ 0.2: the violated row gives way, 0.8. Least violation of both would be d = 0.6."""
    linearization = Linearization([0.0, -1.0, 0.2], [[5.0], [1.0], [-1.0]])
    result = full()(linearization, [0.0, 0.0])
    np.testing.assert_allclose(result.change, [0.2], rtol=1e-9)
    assert result.counts["infeasible"] == 1
    np.testing.assert_allclose(result.predicted_slack, [-0.8, 0.0], atol=1e-9)
    assert result.active.tolist() == [True, True]
    assert not result.stationary
    np.testing.assert_allclose(full(radius=0.1)(linearization, [0.0, 0.0]).change, [0.1], rtol=1e-9)


@pytest.mark.parametrize("seed", [4, 30, 50, 79])
def test_what_rounding_leaves_of_opposing_rows_keeps_no_direction_from_climbing(seed):
    """Rows a and −a, of which the first gives way: b̂ − v is −1e-16 or 1e-16, and 1e-16 is met by nothing."""
    linearization = drawn(seed, 3, 4, "opposed")
    result = full(slack_fraction=0.0, radius=1.0)(linearization, np.zeros(3))
    require_recovery(
        linearization.jacobian, linearization.values[1:], 0.0, linearization.objective_gradient, result.change, 1.0
    )
    assert np.linalg.norm(result.change) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("seed", [799, 2047])
def test_a_recovery_does_not_leave_the_ball_by_rounding(seed):
    """Where demands are large beside the radius, the search for κ ends at 2e-13 and 4e-13 of it."""
    rng = np.random.default_rng(seed)
    V = rng.standard_normal((4, 2))
    V[2] = -V[1] + 10.0 ** rng.uniform(-7, -1) * V[2]
    radius, size = 10.0 ** rng.uniform(-3, 1), 10.0 ** rng.uniform(-3, 3)
    result = full(radius=radius, slack_fraction=0.3)(
        Linearization([0.0, *(size * rng.standard_normal(3))], V), np.zeros(3)
    )
    assert result.counts["infeasible"] == 1
    assert abs(np.linalg.norm(result.change) - radius) <= 3e-15 * radius


def test_of_rows_that_nearly_oppose_each_other_the_ball_lets_through_what_it_can():
    """Both are met at a distance of 1e6: the best point of the ball is where the second row meets the sphere."""
    angle, radius = 1e-6, 77.0
    J = np.array([[1.0, 0.0], [-np.cos(angle), np.sin(angle)]])
    linearization = Linearization([0.0, -1.0, 0.0], np.vstack([[-1.0, 3.0], J]))
    result = full(radius=radius)(linearization, np.zeros(2))
    np.testing.assert_allclose(result.change, [radius * np.sin(angle), radius * np.cos(angle)], rtol=1e-9)


@pytest.mark.parametrize("formulation", ["restoring", "linearized"])
def test_no_step_is_called_stationary_because_its_rows_contradict_each_other(formulation):
    """d = 0 violates least, and Δ¹ = 0 beside it."""
    opposed = Linearization([0.0, -1.0, -1.0], [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0]])
    result = full(formulation=formulation)(opposed, [0.0, 0.0])
    assert not result.change.any()
    assert result.counts["infeasible"] == 1
    assert not result.stationary


@pytest.mark.parametrize("scale", [1e-160, 1e160])
def test_extreme_rows_keep_their_part(scale):
    """A row beyond 2^±400 and its slack in units of its own."""
    linearization = Linearization([0.0, 0.5 * scale, -0.2], [[-1.0, 1.0], [scale, 0.0], [0.0, 1.0]])
    result = full(slack_fraction=0.5)(linearization, [0.0, 0.0])
    np.testing.assert_allclose(result.change, [-0.25, 1.0], rtol=1e-12)


def test_the_limit_is_that_of_violated_rows_without_the_others():
    """v of the first row alone is (1, 0); of both, with the second held, it would be (1, −1)."""
    linearization = Linearization([0.0, -1.0, 0.3], [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    result = full(max_restoration=0.5)(linearization, [0.0, 0.0])
    np.testing.assert_allclose(result.change, [0.5, 0.0], atol=1e-12)
