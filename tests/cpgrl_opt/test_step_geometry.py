"""A step in a metric and in a ball: natural gradients, trust regions, and what stays as it was."""

import base64
import dataclasses
import pickle

import numpy as np
import pytest

from cpgrl_opt import (
    SOLVERS,
    ConstrainedStep,
    Direction,
    DirectionProblem,
    Linearization,
    Status,
    WithGeometry,
    kkt_residuals,
)
from cpgrl_opt.published import CPO
from cpgrl_opt.solvers import is_installed

FORMULATIONS = ["equality", "cone", "restoring", "linearized"]
NOTHING = -100.0  # thresholds that no run violates


def plain(**settings):
    return ConstrainedStep(**{"step_size": 0.02, "restoration_rate": 0.05, "drop": "never", **settings})


def random_linearization(seed, m=2, n=5, runs=()):
    rng = np.random.default_rng(seed)
    return Linearization(rng.standard_normal((*runs, 1 + m)), rng.standard_normal((*runs, 1 + m, n)))


def fisher(seed, n=5):
    root = np.random.default_rng(seed).standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def inner_products(M, gradients):
    return gradients @ np.linalg.solve(M, gradients.T)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_without_active_constraints_a_metric_makes_the_natural_gradient(formulation):
    M, linearization = fisher(0), random_linearization(1)
    step = plain(formulation=formulation, metric=M)(linearization, np.full(2, NOTHING))
    np.testing.assert_allclose(step.change, 0.02 * np.linalg.solve(M, linearization.objective_gradient), rtol=1e-10)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_without_active_constraints_a_radius_is_the_length_of_the_step(formulation):
    M, linearization = fisher(0), random_linearization(1)
    change = plain(formulation=formulation, metric=M, radius=0.7)(linearization, np.full(2, NOTHING)).change
    assert np.sqrt(change @ M @ change) == pytest.approx(0.02 * 0.7, rel=1e-10)


def test_equality_in_a_metric_is_the_projection_and_restoration_in_it():
    """s = M⁻¹(g − Jᵀ(JM⁻¹Jᵀ)⁻¹JM⁻¹g), v = M⁻¹Jᵀ(JM⁻¹Jᵀ)⁻¹t."""
    M, linearization = fisher(2), random_linearization(3)
    thresholds = linearization.values[1:] + np.array([0.3, 0.1])
    J, g = linearization.jacobian, linearization.objective_gradient
    inverse = np.linalg.inv(M)
    gram = np.linalg.inv(J @ inverse @ J.T)
    s = inverse @ (g - J.T @ gram @ J @ inverse @ g)
    v = inverse @ J.T @ gram @ np.array([0.3, 0.1])
    np.testing.assert_allclose(plain(metric=M)(linearization, thresholds).change, 0.02 * s + 0.05 * v, rtol=1e-8)


def test_restoring_with_a_radius_solves_a_trust_region_problem_on_the_active_constraints():
    """max gᵀs s.t. Js ≥ (αₑ/α₁)t, sᵀMs ≤ radius², as the referee sees it in the metric; an observer sees it without."""
    M, linearization, seen = fisher(4), random_linearization(5), []
    thresholds = linearization.values[1:] + np.array([0.02, 0.01])
    step = plain(formulation="restoring", metric=M, radius=2.0)
    result = step(linearization, thresholds, observe=lambda problems, answers: seen.append((problems, answers)))
    [(problems, answers)] = seen
    assert problems[0].radius == 2.0
    assert problems[0].metric is None
    assert answers[0].status == Status.OPTIMAL
    assert answers[0].radius_multiplier > 0
    assert kkt_residuals(problems[0], answers[0]).worst <= 1e-12
    gradients = np.vstack([problems[0].gradient, problems[0].jacobian])
    np.testing.assert_allclose(gradients @ gradients.T, inner_products(M, linearization.gradients), rtol=1e-10)
    given = DirectionProblem(
        linearization.objective_gradient, linearization.jacobian, [0.05, 0.025], metric=M, radius=2.0
    )
    assert kkt_residuals(given, dataclasses.replace(answers[0], value=result.change / 0.02)).worst <= 1e-12


def test_restoring_with_a_radius_is_not_constrained_policy_optimization_where_there_is_slack():
    """The slack of 0.05 keeps the constraint out of ours; CPO asks Jd ≥ −0.05."""
    gradient, row, slack = [-1.0, 0.3], [[1.0, 0.0]], 0.05
    linearization = Linearization([0.0, slack], [gradient, *row])
    settings = {"formulation": "restoring", "step_size": 1.0, "restoration_rate": 1.0}
    ours = ConstrainedStep(**settings, radius=1.0)(linearization, [0.0]).change
    cpo = CPO().solve(DirectionProblem(gradient, row, -slack, radius=1.0))
    np.testing.assert_allclose(ours, np.array(gradient) / np.hypot(1.0, 0.3), rtol=1e-12)
    np.testing.assert_allclose(slack + row @ ours, -0.9078, atol=1e-4)
    np.testing.assert_allclose(cpo.value, [-0.05, np.sqrt(1.0 - 0.05**2)], rtol=1e-12)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_the_step_size_is_one_with_a_radius_and_the_papers_without(formulation):
    assert ConstrainedStep(formulation=formulation).step_size == 0.02
    assert ConstrainedStep(formulation=formulation, radius=0.1).step_size == 1.0
    assert ConstrainedStep(formulation=formulation, radius=0.1, step_size=0.5).step_size == 0.5
    change = ConstrainedStep(formulation=formulation, radius=0.1)(random_linearization(1), np.full(2, NOTHING)).change
    assert np.linalg.norm(change) == pytest.approx(0.1, rel=1e-12)


@pytest.mark.parametrize("step_size", [None, 0.3])
@pytest.mark.parametrize("metric", [None, fisher(13)])
@pytest.mark.parametrize("formulation", ["restoring", "linearized"])
def test_the_radius_bounds_the_change_where_the_restoration_is_inside(formulation, metric, step_size):
    """In reach or out of it; longer than nine tenths of it in both, so that the bound is no idle one."""
    step = ConstrainedStep(formulation=formulation, radius=0.2, metric=metric, step_size=step_size)
    for seed in range(20):
        linearization = random_linearization(seed)
        change = step(linearization, linearization.values[1:] + np.array([0.02, 0.5 * (seed % 2)])).change
        size = np.sqrt(change @ (np.eye(5) if metric is None else metric) @ change)
        assert 0.9 * step.step_size * 0.2 < size <= step.step_size * 0.2 * (1 + 1e-12)


@pytest.mark.parametrize("formulation", ["equality", "cone"])
def test_a_change_that_its_restoration_makes_longer_than_the_radius_is_counted(formulation):
    """s = (0, 1) · radius; v = (10, 0) beside it, (1e-3, 0), or none."""
    rows = [[[0.0, 1.0], [1.0, 0.0]]] * 3
    runs = Linearization([[0.0, -10.0], [0.0, -0.001], [0.0, 1.0]], rows)
    result = ConstrainedStep(formulation=formulation, radius=0.1, restoration_rate=0.05)(runs, [0.0])
    assert result.counts["long"].tolist() == [1, 1, 0]
    still = ConstrainedStep(formulation=formulation, radius=0.1, restoration_rate=0.0)
    assert still(runs, [0.0]).counts["long"].tolist() == [0, 0, 0]
    assert ConstrainedStep(formulation=formulation)(runs, [0.0]).counts["long"].tolist() == [0, 0, 0]


def test_a_restoration_that_the_ball_cannot_reach_is_counted_infeasible():
    linearization = random_linearization(5)
    result = plain(formulation="restoring", radius=0.1)(linearization, linearization.values[1:] + 50.0)
    assert result.counts["infeasible"] == 1
    assert np.linalg.norm(result.change) == pytest.approx(0.02 * 0.1)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("settings", [{}, {"ridge": 0.3}, {"max_restoration": 1e-3}, {"drop": "always"}])
def test_the_identity_as_metric_changes_nothing(formulation, settings):
    if formulation == "linearized":
        settings = {name: value for name, value in settings.items() if name != "ridge"}  # which it refuses
    linearization = random_linearization(6, runs=(3,))
    one, two = (plain(formulation=formulation, metric=M, **settings) for M in (None, np.eye(5)))
    first, second = one(linearization, np.zeros(2)), two(linearization, np.zeros(2))
    np.testing.assert_allclose(second.change, first.change, rtol=1e-12, atol=1e-15)
    for name, count in first.counts.items():
        np.testing.assert_array_equal(second.counts[name], count)


@pytest.mark.parametrize("radius", [None, 0.5])
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_many_runs_at_once_are_the_same_runs_one_by_one(formulation, radius):
    together, M = random_linearization(7, runs=(4,)), fisher(8)
    step = plain(formulation=formulation, metric=M, radius=radius)
    result = step(together, np.zeros(2))
    for k in range(4):
        alone = step(Linearization(together.values[k], together.gradients[k]), np.zeros(2))
        np.testing.assert_array_equal(result.change[k], alone.change)


def test_the_drop_rule_ends_at_the_cone_projection_in_the_metric():
    """One constraint that Δ¹ climbs by itself is dropped, and the step is the natural gradient."""
    M = np.array([[2.0, 0.5], [0.5, 1.0]])
    linearization = Linearization([0.0, -1.0], [[1.0, 1.0], [1.0, 1.0]])
    step = plain(metric=M, drop="stationary", restoration_rate=0.0)
    result = step(linearization, [0.0])
    assert result.counts["dropped"] == 1
    np.testing.assert_allclose(result.change, 0.02 * np.linalg.solve(M, [1.0, 1.0]))


class Plain:
    def solve(self, problem):
        return Direction(problem.gradient.copy(), np.zeros(problem.m), Status.OPTIMAL)


def test_a_solver_that_has_never_heard_of_balls_is_refused_until_it_is_wrapped():
    with pytest.raises(ValueError, match="WithGeometry"):
        plain(solver=Plain(), radius=1.0)
    linearization = random_linearization(1)
    change = plain(solver=WithGeometry(Plain()), radius=2.0)(linearization, np.full(2, NOTHING)).change
    g = linearization.objective_gradient
    np.testing.assert_allclose(change, 0.02 * 2.0 * g / np.linalg.norm(g))


@pytest.mark.parametrize("metric", [np.array([1.0, 2.0, 3.0, 4.0, 5.0]), fisher(11)])
def test_any_solver_is_asked_in_coordinates_where_the_metric_is_the_identity(metric):
    """One that has never heard of metrics, and the closed form of P, s = M⁻¹(g + Jᵀμ) with Js = 0."""
    linearization = random_linearization(1)
    g, M = linearization.objective_gradient, np.diag(metric) if metric.ndim == 1 else metric
    change = plain(solver=Plain(), metric=metric)(linearization, np.full(2, NOTHING)).change
    np.testing.assert_allclose(change, 0.02 * np.linalg.solve(M, g), rtol=1e-10)
    answers = [plain(solver=name, metric=metric)(linearization, np.zeros(2)).change for name in ("rosen", "nnls")]
    np.testing.assert_allclose(*answers, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("radius", [None, 0.4])
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_long_gradients_in_a_diagonal_metric_are_whitened_and_then_reduced(formulation, radius):
    """The change is that of θ in units √Mⱼⱼ, whose gradients are as long."""
    rng = np.random.default_rng(12)
    size, n = rng.uniform(0.5, 2.0, 40_000), 40_000
    long = Linearization(rng.standard_normal(3), rng.standard_normal((3, n)))
    scaled = Linearization(long.values, long.gradients / size)
    seen, settings = [], {"formulation": formulation, "radius": radius}
    thresholds = long.values[1:] + 0.1
    change = plain(**settings, metric=size**2)(long, thresholds, observe=lambda each, _: seen.append(each)).change
    assert {problems.gradient.shape[1] for problems in seen} == {3}  # 1 + m
    np.testing.assert_allclose(change, plain(**settings)(scaled, thresholds).change / size, rtol=1e-12, atol=1e-18)


def test_gradients_that_overflow_where_the_metric_is_the_identity_are_refused():
    linearization = Linearization([0.0, -1.0], [[1.0, 1.0], [1e200, 1.0]])
    with pytest.raises(ValueError, match="gradients should be finite where the metric is the identity"):
        plain(metric=[1e-250, 1.0])(linearization, [0.0])


def test_a_change_that_overflows_in_the_units_of_the_metric_is_refused():
    linearization = Linearization([0.0, 1.0], [[1e160, 1.0], [0.0, 1.0]])
    with pytest.raises(FloatingPointError, match="in the units of the metric"):
        plain(metric=[1e-200, 1.0])(linearization, [0.0])


def test_every_solver_of_ours_is_taken():
    for name, solver in SOLVERS.items():
        if is_installed(solver):
            assert plain(solver=name, radius=1.0).radius == 1.0


def test_steps_compare_by_their_metric():
    one, two, three = plain(metric=[1.0, 2.0]), plain(metric=[1.0, 2.0]), plain(metric=[1.0, 3.0])
    assert one == two
    assert hash(one) == hash(two)
    assert one != three
    assert dataclasses.replace(one, radius=1.0).metric.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("formulation", ["equality", "cone"])
def test_the_radius_is_the_tangents_and_not_the_restorations(formulation):
    """v = J⁺t is 10 long in a ball of radius 0.1."""
    linearization = Linearization([0.0, -10.0], [[0.0, 1.0], [1.0, 0.0]])
    result = plain(formulation=formulation, radius=0.1)(linearization, [0.0])
    np.testing.assert_allclose(result.change, [0.05 * 10.0, 0.02 * 0.1], rtol=1e-12)
    assert result.counts["infeasible"] == 0


@pytest.mark.parametrize("metric", [np.array([1.0, 2.0, 3.0, 4.0, 5.0]), fisher(9)])
def test_the_ridge_in_a_metric_is_the_regularised_inverse_in_it(metric):
    """(JM⁻¹Jᵀ + εI)⁻¹ in s and v."""
    linearization, ridge = random_linearization(10), 0.3
    inverse = np.linalg.inv(np.diag(metric) if metric.ndim == 1 else metric)
    J, g = linearization.jacobian, linearization.objective_gradient
    soft = np.linalg.inv(J @ inverse @ J.T + ridge * np.eye(2))
    target = np.array([0.3, 0.1])
    expected = 0.02 * inverse @ (g - J.T @ soft @ J @ inverse @ g) + 0.05 * inverse @ J.T @ soft @ target
    seen = []
    step = plain(metric=metric, ridge=ridge)
    result = step(linearization, linearization.values[1:] + target, observe=lambda problems, _: seen.append(problems))
    np.testing.assert_allclose(result.change, expected, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(seen[0][0].jacobian[:, 5:], np.sqrt(ridge) * np.eye(2))


# ConstrainedStep(formulation="restoring", metric=[1.0, 4.0], radius=0.5), when such a step kept a StepGeometry.
OLD_PICKLE = (
    "gASVCgMAAAAAAACMDmNwZ3JsX29wdC5zdGVwlIwPQ29uc3RyYWluZWRTdGVwlJOUKYGUfZQojAZzb2x2ZXKUjBxjcGdybF9vcHQu"
    "c29sdmVycy5hY3RpdmVfc2V0lIwJQWN0aXZlU2V0lJOUKYGUfZSMCXRvbGVyYW5jZZRHPhEuC+gm1pVzYowLZm9ybXVsYXRpb26U"
    "jAlyZXN0b3JpbmeUjARydWxllIwUY3Bncmxfb3B0LmFjdGl2ZV9zZXSUjAh2aW9sYXRlZJSTlIwJc3RlcF9zaXpllEc/lHrhR64U"
    "e4wQcmVzdG9yYXRpb25fcmF0ZZRHP5R64UeuFHuMBGRyb3CUjApzdGF0aW9uYXJ5lIwPcmF3X211bHRpcGxpZXJzlImMBXJpZGdl"
    "lEcAAAAAAAAAAIwPbWF4X3Jlc3RvcmF0aW9ulEd/8AAAAAAAAIwKb25fZmFpbHVyZZSMCGZhbGxiYWNrlIwGbWV0cmljlIwWbnVt"
    "cHkuX2NvcmUubXVsdGlhcnJheZSMDF9yZWNvbnN0cnVjdJSTlIwFbnVtcHmUjAduZGFycmF5lJOUSwCFlEMBYpSHlFKUKEsBSwKF"
    "lGgfjAVkdHlwZZSTlIwCZjiUiYiHlFKUKEsDjAE8lE5OTkr/////Sv////9LAHSUYolDEAAAAAAAAPA/AAAAAAAAEECUdJRijAZy"
    "YWRpdXOURz/gAAAAAAAAjA1fbWV0cmljX2J5dGVzlEMQAAAAAAAA8D8AAAAAAAAQQJSMCV9nZW9tZXRyeZSMF2NwZ3JsX29wdC5z"
    "dGVwX2dlb21ldHJ5lIwMU3RlcEdlb21ldHJ5lJOUKYGUfZQoaBtoJYwJd2hpdGVuaW5nlIwQY3Bncmxfb3B0Lm1ldHJpY5SMCVdo"
    "aXRlbmluZ5STlCmBlH2UKIwGZmFjdG9ylGgeaCFLAIWUaCOHlFKUKEsBSwKFlGgriUMQAAAAAAAA8D8AAAAAAAAAQJR0lGKMCmNv"
    "cnJlY3Rpb26UTnViaDBHP+AAAAAAAAB1YowHX2RpcmVjdJROdWIu"
)


def test_a_step_that_was_pickled_with_a_metric_and_a_radius_is_read() -> None:
    step = pickle.loads(base64.b64decode(OLD_PICKLE))
    assert step == plain(
        formulation="restoring", metric=[1.0, 4.0], radius=0.5, restoration_rate=0.02, drop="stationary"
    )
    linearization = Linearization([0.0, -1.0], [[1.0, 2.0], [1.0, 0.0]])
    again = pickle.loads(pickle.dumps(step))
    np.testing.assert_array_equal(step(linearization, [0.0]).change, again(linearization, [0.0]).change)
