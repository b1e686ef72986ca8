"""What holds of every step: runs apart, coordinates, solvers and scales change nothing, and each change is proven."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cpgrl_opt import SOLVERS, ConstrainedStep, DirectionProblem, Linearization
from cpgrl_opt.solvers import is_usable, supports

from .steps import ACTIVE_ONLY, FORMULATIONS, KINDS, drawn, full, plain, require_same

METRIC = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 3.0]])
SETTINGS = [
    {},
    {"drop": "stationary"},
    {"drop": "always"},
    {"max_restoration": 0.01},
    {"ridge": 0.3},
    {"radius": 0.3},
    {"radius": 0.3, "max_restoration": 0.01},
]
STEPS = [
    (formulation, chosen)
    for formulation in FORMULATIONS
    for chosen in SETTINGS
    if formulation == "equality" or "drop" not in chosen
    if formulation != "linearized" or "ridge" not in chosen
]


@pytest.mark.parametrize(("formulation", "chosen"), STEPS)
@pytest.mark.parametrize("metric", [None, METRIC], ids=["no metric", "metric"])
def test_many_runs_at_once_are_the_same_runs_one_by_one(formulation, chosen, metric):
    runs = [drawn(1, kind=kind) for kind in KINDS]
    runs.append(Linearization(runs[0].values, 1e160 * runs[0].gradients))
    together = Linearization([each.values for each in runs], [each.gradients for each in runs])
    step = plain(formulation=formulation, metric=metric, **chosen)
    result = step(together, np.zeros(3))
    assert result.counts["dropped"].any() == (formulation == "equality" and "drop" in chosen)
    assert result.counts["capped"].any() == ("max_restoration" in chosen)
    for k, each in enumerate(runs):
        alone = step(each, np.zeros(3))
        for name in ("change", "active", "stationary", "multipliers", "residuals", "predicted_slack"):
            np.testing.assert_array_equal(getattr(result, name)[k], getattr(alone, name), err_msg=name)
        assert {name: count[k] for name, count in result.counts.items()} == alone.counts


FORMS = {
    "diagonal": (np.diag([1.0, 4.0, 0.5]), np.array([1.0, 4.0, 0.5])),
    "dense": (METRIC, METRIC),
    "function": (METRIC, METRIC.__matmul__),
}


@pytest.mark.parametrize(("formulation", "chosen"), STEPS)
@pytest.mark.parametrize("form", FORMS)
def test_a_metric_changes_the_coordinates_and_nothing_else(formulation, chosen, form):
    """M = LLᵀ: Lᵀ change is the step on the rows L⁻¹J, and everything that is said of it the same."""
    M, metric = FORMS[form]
    root = np.linalg.cholesky(M)
    for kind in ("generic", "integers"):
        given = drawn(5, kind=kind)
        euclidean = Linearization(given.values, np.linalg.solve(root, given.gradients.T).T)
        there, here = (
            full(formulation=formulation, metric=each, **{"drop": "never", **chosen})(linearization, np.zeros(3))
            for each, linearization in ((None, euclidean), (metric, given))
        )
        here.change[:] = root.T @ here.change
        require_same(here, there, atol=1e-9)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("name", SOLVERS)
def test_every_solver_makes_the_same_step(name, formulation):
    """What a solver does not take falls back, and nothing else."""
    solver = SOLVERS[name]
    if not is_usable(solver):
        pytest.skip(f"{name} is not installed")
    bounds = DirectionProblem([1.0, 1.0], [[-1.0, 0.0]], bound=[-0.5])
    for kind, radius in (("sum", None), ("generic", 0.5)):
        given, chosen = drawn(2, kind=kind), {"formulation": formulation, "radius": radius, "slack_fraction": 0.5}
        chosen = chosen if formulation == "linearized" else {**chosen, "slack_fraction": 1.0}
        result, exact = (full(solver=each, **chosen)(given, np.zeros(3)) for each in (solver, "active-set"))
        np.testing.assert_allclose(result.change, exact.change, atol=3 * solver.tolerance)
        assert result.counts["infeasible"] == exact.counts["infeasible"]
        if formulation == "linearized":
            assert bool(result.counts["fallback"]) <= (not supports(solver, bounds))


def require_proof(step, linearization, result):
    """α₁ s = change − αₑ v is along M⁻¹(g + Jᵀμ), μ ≥ 0 but for equalities; J change leads to the predicted slack."""
    J, slack = linearization.jacobian, linearization.slack(np.zeros(linearization.gradients.shape[-2] - 1))
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
        np.testing.assert_allclose(result.change, step.step_size * s, atol=1e-9)


WAYS = {
    "usual": {},
    "by a QP": {"solver": "quadprog"},
    "metric": {"metric": METRIC},
    "radius": {"radius": 0.3, "step_size": 0.02},
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("formulation", FORMULATIONS)
@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), m=st.integers(0, 2), rate=st.sampled_from([0.0, 0.05]))
def test_a_step_proves_its_change(formulation, way, seed, m, rate):
    linearization = drawn(seed, m, size=0.1)
    step = ConstrainedStep(formulation=formulation, drop="never", restoration_rate=rate, **WAYS[way])
    result = step(linearization, np.zeros(m))
    if not result.counts["infeasible"]:  # out of the ball's reach
        require_proof(step, linearization, result)


@pytest.mark.parametrize("formulation", ACTIVE_ONLY)
@pytest.mark.parametrize("scale", [1e-170, 1e-8, 1e8, 1e170])
def test_changes_scale_with_the_gradients_and_restorations_with_their_inverse(formulation, scale):
    one = Linearization([0.0, -1.0, -0.5], [[1.0, 1.0, 0.0], [-1.0, 2.0, 0.0], [0.0, 1.0, 1.0]])
    for values, rates, factor in (
        (one.values, (1.0, 0.0), scale),
        (one.values, (0.0, 1.0), 1.0 / scale),
        (0.0 * one.values, (1.0, 1.0), scale),
    ):
        if formulation == "restoring" and values.any():
            continue
        step = plain(formulation=formulation, step_size=rates[0] or 0.0, restoration_rate=rates[1])
        right, found = (step(Linearization(values, each * one.gradients), [0.0, 0.0]) for each in (1.0, scale))
        np.testing.assert_allclose(found.change / factor, right.change, rtol=1e-12, atol=1e-15)
        assert found.counts["fallback"] == found.counts["skipped"] == 0
    mixed = plain(formulation=formulation)(Linearization(one.values, scale * one.gradients), [0.0, 0.0])
    assert np.isfinite(mixed.change).all()
    assert mixed.change.any()


@pytest.mark.parametrize("solver", ["active-set", "rosen"])
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("runs", [(), (20,), (2, 3)])
def test_the_usual_way_in_one_compiled_call_gives_the_bits_of_the_long_way(runs, formulation, solver):
    """An observer is told of each subproblem, which the one call does not do."""
    rng = np.random.default_rng(5)
    step = ConstrainedStep(solver=solver, formulation=formulation)
    for trial in range(6):
        m = 1 + trial % 4
        gradients = rng.standard_normal((*runs, 1 + m, 7))
        if trial % 3 == 1:
            gradients[..., -1, :] = gradients[..., 1, :]  # rows that depend
        if trial % 3 == 2:
            gradients[..., 1, :] *= rng.choice([0.0, 1e-3, 1e200])  # flat or extreme rows
        linearization = Linearization(0.1 * rng.standard_normal((*runs, 1 + m)), gradients)
        direct = step(linearization, np.zeros(m))
        require_same(direct, step(linearization, np.zeros(m), observe=lambda *_: None))
        assert (direct.change.shape, direct.stationary.shape) == ((*runs, 7), runs)
        for name, size in (("multipliers", m), ("residuals", 4), ("predicted_slack", m)):
            assert getattr(direct, name).shape == (*runs, size)


@pytest.mark.parametrize("solver", ["active-set", "nnls", "rosen-drop"])
@pytest.mark.parametrize("chosen", [{}, {"radius": 1.0}, {"metric": [1.0, 2.0]}, {"max_restoration": 1.0}])
def test_no_runs_are_no_changes(solver, chosen):
    for formulation in FORMULATIONS:
        step = ConstrainedStep(solver=solver, formulation=formulation, **chosen)
        result = step(Linearization(np.zeros((0, 3)), np.zeros((0, 3, 2))), [0.0, 0.0])
        assert (result.change.shape, result.stationary.shape) == ((0, 2), (0,))


@pytest.mark.parametrize("runs", [(2,), (1, 2), (2, 1), (2, 2)])
@pytest.mark.parametrize("order", [np.asfortranarray, lambda array: array[..., ::-1].copy()[..., ::-1]])
def test_a_step_does_not_care_how_its_arrays_lie_in_memory(runs, order):
    """V[:, columns] lies in Fortran order: a TypeError of numba, once."""
    right = drawn(0, runs=runs)
    values, gradients = order(right.values), order(right.gradients)
    values.flags.writeable = gradients.flags.writeable = False
    found = ConstrainedStep()(Linearization(values, gradients), np.zeros(3))
    assert found.change.tobytes() == ConstrainedStep()(right, np.zeros(3)).change.tobytes()
