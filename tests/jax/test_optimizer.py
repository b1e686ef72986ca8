"""`constrain`: whatever optax proposes, no constraint is left worse than the formulation asks, to first order."""

from functools import partial
from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax")
optax = pytest.importorskip("optax")

import jax.numpy as jnp  # noqa: E402

from cpgrl_opt import ConstrainedStep, DirectionProblem, Status, solve  # noqa: E402
from cpgrl_opt.jax import ConstrainState, constrain  # noqa: E402

M, N = 4, 7
OPTIMIZERS = {
    "sgd": optax.sgd(0.1, momentum=0.9),
    "adam": optax.adam(0.1),
    "adamw in a chain": optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(0.1, weight_decay=0.1)),
    "amsgrad": optax.amsgrad(0.1),
    "rmsprop": optax.rmsprop(0.1),
    "adagrad": optax.adagrad(0.1),
    "lion": optax.lion(0.1),
}
STEPS = {
    "restoring": ConstrainedStep(formulation="restoring", restoration_rate=0.5),
    "linearized": ConstrainedStep(formulation="linearized", restoration_rate=0.25, slack_fraction=0.5),
}

TWO = optax.chain(optax.scale_by_adam(), optax.scale_by_rms())
CONE = ConstrainedStep(formulation="cone")


def tree(v: np.ndarray, dtype: str = "float64") -> Any:
    return {"b": jnp.asarray(v[..., :3], dtype), "w": jnp.asarray(v[..., 3:].reshape(*v.shape[:-1], 2, 2), dtype)}


def flat(grown: Any) -> np.ndarray:
    w = np.asarray(grown["w"], np.float64)
    return np.concatenate([np.asarray(grown["b"], np.float64), w.reshape(*w.shape[:-2], 4)], axis=-1)


def demand(step: ConstrainedStep, slack: np.ndarray) -> np.ndarray:
    """What slack + J·Δθ should be at least; a constraint with slack may lose all of it, or what `linearized` allows."""
    left = slack * (1.0 - step.slack_fraction) if step.formulation == "linearized" else np.full(len(slack), -np.inf)
    return np.where(slack > 0.0, left, slack * (1.0 - step.restoration_rate))


@pytest.mark.parametrize("formulation", STEPS)
@pytest.mark.parametrize("name", OPTIMIZERS)
def test_no_constraint_is_left_worse_than_asked(name: str, formulation: str) -> None:
    """Ten updates of one parameter tree, each with gradients and slack of its own."""
    rng, step = np.random.default_rng(len(name)), STEPS[formulation]
    optimizer = constrain(OPTIMIZERS[name], step, np.zeros(M), kind="reward")
    params = tree(rng.normal(size=N))
    state = optimizer.init(params)
    for _ in range(10):
        g, J, slack = rng.normal(size=N), rng.normal(size=(M, N)), rng.normal(size=M) * 0.1
        rows = {"constraint_values": slack, "constraint_gradients": tree(J)}
        change, state = optimizer.update(tree(g), state, params, **rows)
        moved = slack + J @ flat(change)
        assert state.info.status == Status.OPTIMAL
        assert (moved - demand(step, slack)).min() >= -1e-9
        np.testing.assert_allclose(state.info.predicted_slack, moved, atol=1e-12)
        params = optax.apply_updates(params, change)


def test_the_metric_is_what_adam_divides_by() -> None:
    """argmin ½‖Δ′ − Δ‖²_H by the solver of NumPy's users; a metric of the caller's likewise."""
    rng, inner, step = np.random.default_rng(0), OPTIMIZERS["adam"], STEPS["restoring"]
    params, g, J, costs = tree(np.zeros(N)), rng.normal(size=N), rng.normal(size=(M, N)), np.full(M, 0.1)
    weights = rng.uniform(0.5, 2.0, N)
    for metric, H in ((None, np.abs(g) + 1e-8), (lambda _: tree(weights), weights)):
        optimizer = constrain(inner, step, np.zeros(M), metric=metric)
        rows = {"constraint_values": costs, "constraint_gradients": [tree(row) for row in J]}
        change, state = optimizer.update(tree(g), optimizer.init(params), params, **rows)
        proposed, _ = inner.update(tree(g), inner.init(params), params)
        problem = DirectionProblem(H * flat(proposed), -J, step.restoration_rate * costs, metric=H)
        expected = solve(problem)
        assert expected.multipliers.max() > 0.0
        np.testing.assert_allclose(flat(change), expected.value, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(state.info.multipliers, expected.multipliers, rtol=1e-5, atol=1e-9)


def test_constraints_are_named_and_eps_is_told() -> None:
    """By name in whatever order: the same update, and what happened by name."""
    rng, step, names = np.random.default_rng(1), STEPS["linearized"], ["heat", "wear", "noise", "cost"]
    params, g, J, costs = tree(np.zeros(N)), rng.normal(size=N), rng.normal(size=(M, N)), rng.normal(size=M) * 0.1
    inner = optax.adam(0.1, b2=0.9, eps=0.1)
    given = {"constraint_values": costs, "constraint_gradients": tree(J)}
    plain = constrain(inner, step, np.zeros(M), b2=0.9, eps=0.1)
    change, state = plain.update(tree(g), plain.init(params), params, **given)
    weights = lambda _: tree(np.abs(g) + 0.1)  # noqa: E731
    told = constrain(inner, step, np.zeros(M), metric=weights)
    np.testing.assert_allclose(
        flat(change), flat(told.update(tree(g), told.init(params), params, **given)[0]), atol=1e-12
    )
    named = constrain(inner, step, dict.fromkeys(names, 0.0), b2=0.9, eps=0.1)
    before = named.init(params)
    given = {
        "constraint_values": dict(zip(names[::-1], costs[::-1], strict=True)),
        "constraint_gradients": {name: tree(row) for name, row in zip(names[::-1], J[::-1], strict=True)},
    }
    same, after = named.update(tree(g), before, params, **given)
    np.testing.assert_array_equal(flat(same), flat(change))
    for field in ("multipliers", "active", "slack", "predicted_slack"):
        assert [getattr(after.info, field)[name] for name in names] == [*getattr(state.info, field)]
    assert jax.tree.structure(before) == jax.tree.structure(after)


def test_it_goes_through_scan_and_ends_feasible() -> None:
    """min ‖θ − 2‖² s.t. θ₀ ≤ 1, from outside, by Adam in float32."""
    step = STEPS["linearized"]
    optimizer = constrain(optax.adam(0.05), step, [1.0])
    loss = lambda theta: jnp.sum((theta - 2.0) ** 2)  # noqa: E731

    def advance(carry: Any, _: Any) -> Any:
        theta, state = carry
        rows = {"constraint_values": theta[:1], "constraint_gradients": jax.jacrev(lambda x: x[:1])(theta)}
        change, state = optimizer.update(jax.grad(loss)(theta), state, theta, **rows)
        return (optax.apply_updates(theta, change), state), state.info.slack

    theta = jnp.array([1.5, 0.0], "float32")
    (theta, state), slack = jax.jit(partial(jax.lax.scan, advance, length=300))((theta, optimizer.init(theta)))
    assert isinstance(state, ConstrainState)
    assert slack[0, 0] < 0.0
    assert (np.diff(slack[:10, 0]) > 0.0).all()
    np.testing.assert_allclose(theta, [1.0, 2.0], atol=0.05)
    assert theta[0] <= 1.0 + 1e-5


def test_what_is_not_finite_moves_nothing_and_the_optimiser_forgets_it() -> None:
    optimizer = constrain(optax.adam(0.1), STEPS["restoring"], [0.0])
    params = tree(np.zeros(N))
    before = optimizer.init(params)
    bad, good = np.full(N, np.nan), np.ones(N)
    one, none = np.ones(1), np.full(1, np.nan)
    for g, row, cost, limit in (
        (bad, good, one, one),
        (good, bad, one, one),
        (good, good, none, one),
        (good, good, one, none),
        (good, good, -np.inf * one, one),
    ):
        rows = {"constraint_values": cost, "constraint_gradients": tree(row[None]), "thresholds": limit}
        change, state = optimizer.update(tree(g), before, params, **rows)
        assert state.info.status == Status.NUMERICAL_ERROR
        assert not flat(change).any()
        assert jax.tree.all(jax.tree.map(lambda a, b: bool((a == b).all()), state.inner, before.inner))


@pytest.mark.parametrize(
    ("said", "change"),
    [
        ("optimizer should be one of optax; found None", {"optimizer": None}),
        ("step should have no radius", {"step": ConstrainedStep(formulation="restoring", radius=1.0)}),
        ("formulation of step should be restoring or linearized; found 'cone'", {"path": "host", "step": CONE}),
        ("metric should be a function of the optimiser's state; found 3", {"metric": 3}),
        ("thresholds should be finite", {"thresholds": [np.nan]}),
        ("metric should return a tree as the parameters are", {"metric": lambda _: [1.0]}),
        ("constraint_values should have shape", {"constraint_values": np.zeros(2)}),
        ("constraint_gradients should have the structure and shapes", {"constraint_gradients": np.zeros((1, N))}),
        ("constraint_values= should be given to update", {"constraint_values": None}),
        ("constraint_gradients= should be given to update", {"constraint_gradients": None}),
        ("constraint_values should be a dict with the names a; found", {"thresholds": {"a": 0.0}}),
        ("second moments, of all parameters, or metric should be given; found 2", {"optimizer": TWO}),
    ],
)
def test_what_does_not_fit_is_refused_while_it_is_traced(said: str, change: dict[str, Any]) -> None:
    given = {"optimizer": optax.sgd(0.1), "step": STEPS["restoring"], "thresholds": [0.0]}
    rows = {"constraint_values": np.zeros(1), "constraint_gradients": tree(np.ones((1, N)))}
    given.update({name: value for name, value in change.items() if name not in rows})
    rows.update({name: value for name, value in change.items() if name in rows})
    params = tree(np.zeros(N))

    def run() -> Any:
        optimizer = constrain(**given)
        return jax.eval_shape(partial(optimizer.update, **rows), params, optimizer.init(params), params)

    with pytest.raises(ValueError, match=said):
        run()
