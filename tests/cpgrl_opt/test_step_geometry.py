"""A step in a metric and in a ball: natural gradients, trust regions, and what stays as it was."""

import base64
import dataclasses
import pickle

import numpy as np
import pytest

from cpgrl_opt import (
    ConstrainedStep,
    DirectionProblem,
    Linearization,
    Status,
    WithGeometry,
    kkt_residuals,
)

from .steps import FORMULATIONS, Claiming, drawn, plain

NOTHING = -100.0  # thresholds that no run violates


def fisher(seed, n=5):
    root = np.random.default_rng(seed).standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def test_restoring_with_a_radius_solves_a_trust_region_problem_on_the_active_constraints():
    """max gᵀs s.t. Js ≥ (αₑ/α₁)t, sᵀMs ≤ radius², as the referee sees it in the metric; an observer sees it without."""
    M, linearization, seen = fisher(4), drawn(5, 2, 5), []
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
    products = linearization.gradients @ np.linalg.solve(M, linearization.gradients.T)
    np.testing.assert_allclose(gradients @ gradients.T, products, rtol=1e-10)
    given = DirectionProblem(
        linearization.objective_gradient, linearization.jacobian, [0.05, 0.025], metric=M, radius=2.0
    )
    assert kkt_residuals(given, dataclasses.replace(answers[0], value=result.change / 0.02)).worst <= 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_the_step_size_is_one_with_a_radius_and_the_papers_without(formulation):
    assert ConstrainedStep(formulation=formulation).step_size == 0.02
    assert ConstrainedStep(formulation=formulation, radius=0.1).step_size == 1.0
    assert ConstrainedStep(formulation=formulation, radius=0.1, step_size=0.5).step_size == 0.5
    change = ConstrainedStep(formulation=formulation, radius=0.1)(drawn(1, 2, 5), np.full(2, NOTHING)).change
    assert np.linalg.norm(change) == pytest.approx(0.1, rel=1e-12)


@pytest.mark.parametrize("step_size", [None, 0.3])
@pytest.mark.parametrize("metric", [None, fisher(13)])
@pytest.mark.parametrize("formulation", ["restoring", "linearized"])
def test_the_radius_bounds_the_change_where_the_restoration_is_inside(formulation, metric, step_size):
    """In reach or out of it; longer than nine tenths of it in both, so that the bound is no idle one."""
    step = ConstrainedStep(formulation=formulation, radius=0.2, metric=metric, step_size=step_size)
    for seed in range(20):
        linearization = drawn(seed, 2, 5)
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
    np.testing.assert_allclose(result.change[0], [0.05 * 10.0, 0.1], rtol=1e-12)
    assert not result.counts["infeasible"].any()
    still = ConstrainedStep(formulation=formulation, radius=0.1, restoration_rate=0.0)
    assert still(runs, [0.0]).counts["long"].tolist() == [0, 0, 0]
    assert ConstrainedStep(formulation=formulation)(runs, [0.0]).counts["long"].tolist() == [0, 0, 0]


def test_a_solver_that_has_never_heard_of_balls_is_refused_until_it_is_wrapped():
    climbs = Claiming(None, Status.OPTIMAL)
    with pytest.raises(ValueError, match="WithGeometry"):
        plain(solver=climbs, radius=1.0)
    linearization = drawn(1, 2, 5)
    change = plain(solver=WithGeometry(climbs), radius=2.0)(linearization, np.full(2, NOTHING)).change
    g = linearization.objective_gradient
    np.testing.assert_allclose(change, 0.02 * 2.0 * g / np.linalg.norm(g))


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


def test_steps_compare_by_their_metric():
    one, two, three = plain(metric=[1.0, 2.0]), plain(metric=[1.0, 2.0]), plain(metric=[1.0, 3.0])
    assert one == two
    assert hash(one) == hash(two)
    assert one != three
    assert dataclasses.replace(one, radius=1.0).metric.tolist() == [1.0, 2.0]


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
