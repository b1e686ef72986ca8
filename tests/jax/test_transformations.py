"""jit, scan, lists of trees, float32, the host path, costs: the same answers; bad input: an error, or a status."""

import warnings
from functools import partial
from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax")

import jax.numpy as jnp  # noqa: E402

from cpgrl_opt import FORMULATIONS, ConstrainedStep, Linearization, Status, hysteresis  # noqa: E402
from cpgrl_opt.jax import constrained_direction  # noqa: E402

M, N, RUNS = 2, 5, 8
STEP = ConstrainedStep(formulation="linearized", step_size=0.5, restoration_rate=0.25)


def draw(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Values and gradients of 8 runs, costs; limits are 0."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(RUNS, 1 + M)) * 0.1, rng.normal(size=(RUNS, 1 + M, N))


def expect(step: ConstrainedStep, values: np.ndarray, V: np.ndarray) -> Any:
    return step(Linearization(-values, -V), np.zeros(M))


def direct(values: Any, V: Any, limits: Any) -> Any:
    return constrained_direction(values, {"a": V[:, :2], "b": V[:, 2:]}, limits, STEP)


@pytest.fixture(scope="module")
def scan() -> Any:
    """Of 8 runs; one compiled call for all tests that can share it."""
    return jax.jit(lambda *runs: jax.lax.scan(lambda carry, run: (carry, direct(*run)), 0, runs)[1])


def flat(gradient: Any) -> np.ndarray:
    return np.concatenate([gradient["a"], gradient["b"]], axis=-1)


def test_costs_and_rewards_differ_in_sign_alone() -> None:
    values, V = draw(0)
    limits = np.array([0.1, -0.05])
    signs = np.array([1.0, -1.0, -1.0])
    gradient, info = direct(values[0], V[0], limits)
    turned = {"a": signs[:, None] * V[0, :, :2], "b": signs[:, None] * V[0, :, 2:]}
    found, same = constrained_direction(signs * values[0], turned, -limits, STEP, kind="reward")
    np.testing.assert_allclose(flat(gradient), flat(found), atol=1e-14)
    np.testing.assert_allclose(info.slack, limits - values[0, 1:])
    np.testing.assert_allclose(info.multipliers, same.multipliers, atol=1e-14)
    np.testing.assert_allclose(flat(gradient), V[0, 0] + info.multipliers @ V[0, 1:], atol=1e-14)


def test_it_goes_through_scan(scan: Any) -> None:
    values, V = draw(1)
    gradient, info = scan(values, V, np.zeros((RUNS, M)))
    np.testing.assert_allclose(-0.5 * flat(gradient), expect(STEP, values, V).change, atol=1e-14)
    assert (info.status == Status.OPTIMAL).all()


def test_a_list_of_trees_is_what_the_stacked_tree_is() -> None:
    values, V = draw(2)
    listed = [{"a": row[:2], "b": row[2:]} for row in V[0]]
    gradient, _ = constrained_direction(values[0], listed, np.zeros(M), STEP)
    np.testing.assert_array_equal(flat(gradient), flat(direct(values[0], V[0], np.zeros(M))[0]))
    with pytest.raises(ValueError, match="found what may be either"):
        constrained_direction(values[0], [*V[0, :, :3]], np.zeros(M), STEP)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_the_host_answers_a_whole_batch_as_the_step_does(formulation: str) -> None:
    calls: list[int] = []

    class Counted(ConstrainedStep):
        def __call__(self, *given: Any) -> Any:
            calls.append(len(given[0].values))
            return super().__call__(*given)

    step = Counted(formulation=formulation, step_size=0.5, restoration_rate=0.25)
    values, V = draw(3)
    V[0, 2] = -V[0, 1]
    values[0, 1:] = 0.2  # nothing meets both
    values[1, 0] = np.nan
    ask = partial(constrained_direction, thresholds=np.zeros(M), step=step, path="host")
    gradient, info = jax.jit(jax.vmap(lambda v, G: ask(v, G)))(values, V)
    assert calls == [RUNS]
    values[1, 0] = 0.0
    expected = expect(step, values, V)
    fine = np.arange(RUNS) != 1
    np.testing.assert_allclose(-0.5 * gradient[fine], expected.change[fine], atol=1e-14)
    np.testing.assert_allclose(info.multipliers[fine], expected.multipliers[fine], atol=1e-14)
    np.testing.assert_array_equal(info.active[fine], expected.active[fine])
    assert [*info.status[:2]] == [Status.INFEASIBLE, Status.NUMERICAL_ERROR]
    assert not np.asarray(gradient[1]).any()


@pytest.mark.parametrize(("dtype", "has_float64"), [("bfloat16", True), ("float32", False)])
def test_short_floats_are_certified_in_the_widest_one(dtype: str, has_float64: bool) -> None:
    values, V = draw(4)
    jax.config.update("jax_enable_x64", has_float64)
    V = np.asarray(jnp.asarray(V, dtype).astype("float32"), np.float64)
    given = jnp.asarray(values, "float32"), jnp.asarray(V, dtype), jnp.zeros(M)
    gradient, info = jax.jit(jax.vmap(partial(constrained_direction, step=STEP), in_axes=(0, 0, None)))(*given)
    expected = expect(STEP, np.asarray(given[0], np.float64), V)
    assert gradient.dtype == dtype
    assert info.residuals.dtype == ("float64" if has_float64 else "float32")
    assert (info.status == Status.OPTIMAL).all()
    assert info.residuals.max() <= (1e-12 if has_float64 else 1e-5)
    np.testing.assert_allclose(info.tolerance, 1e-9 if has_float64 else 64 * 2.0**-23)
    close = 1e-6 if dtype == "float32" else 2.0**-6
    np.testing.assert_allclose(-0.5 * np.asarray(gradient, np.float64), expected.change, atol=close)


@pytest.mark.parametrize("path", ["device", "host"])
@pytest.mark.parametrize("size", [1e-42, 1e-30, 1e-20, 1.0, 1e20, 1e30])
def test_float32_of_any_size_is_no_error(size: float, path: str) -> None:
    """μ of 4e59 is infinite, J d of 1e40 too, d is right; where d = 0 none of it is −0."""
    jax.config.update("jax_enable_x64", False)
    V = np.array([[1.0, 2.0, 0.0], [1.0, -0.5, 0.0], [0.0, 1.5, 0.0]]) * size
    step = ConstrainedStep(formulation="linearized", step_size=0.1, restoration_rate=0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gradient, info = constrained_direction(
            [0.0, 0.1, -0.2], jnp.asarray(V, "float32"), np.zeros(2), step, path=path
        )
    assert info.status == Status.OPTIMAL
    assert not np.signbit(gradient[2])
    assert not np.isnan(np.concatenate([info.multipliers, info.predicted_slack])).any()
    if size > 1e-37:  # smaller ones are 0 to XLA, which flushes them
        expected = expect(step, np.array([[0.0, 0.1, -0.2]]), np.asarray(np.float32(V), float)[None])
        np.testing.assert_allclose(gradient, -10.0 * expected.change[0], rtol=1e-5)
        with np.errstate(over="ignore"):
            mu, slack = (each[0].astype("float32") for each in (expected.multipliers, expected.predicted_slack))
        np.testing.assert_allclose(info.multipliers, mu, rtol=1e-5)
        said = np.isinf(slack) | (size <= 1.0)  # beside ‖J‖‖d‖ = 1e40 a slack of 0.1 is rounding
        np.testing.assert_allclose(info.predicted_slack[said], slack[said], rtol=1e-5, atol=1e-6)


def test_constraints_are_named() -> None:
    values, V = draw(7)
    gradient, info = constrained_direction(values[0], V[0], np.array([0.1, -0.05]), STEP)
    limits = {"wear": -0.05, "heat": 0.1}
    given = [(each[0], {"heat": each[1], "wear": each[2]}) for each in (values[0], V[0])]
    found, named = jax.jit(partial(constrained_direction, step=STEP))(given[0], given[1], limits)
    np.testing.assert_allclose(found, gradient, atol=1e-14)
    for field in ("multipliers", "active", "slack", "predicted_slack"):
        ours = getattr(named, field)
        np.testing.assert_allclose([ours["heat"], ours["wear"]], getattr(info, field), atol=1e-14)
    for wrong in ((given[0][0], {"heat": 0.0}), values[0]):
        with pytest.raises(ValueError, match=r"values (of constraints )?should be a"):
            constrained_direction(wrong, given[1], limits, STEP)


def test_nothing_is_nan_under_jit_and_outside_it_is_an_error(scan: Any) -> None:
    values, V = draw(5)
    given = values, V, np.zeros((RUNS, M))
    for k, bad in enumerate((np.nan, np.inf, np.nan)):
        given[k][k].flat[-1] = bad
    gradient, info = scan(*given)
    assert [*info.status] == [Status.NUMERICAL_ERROR] * 3 + [Status.OPTIMAL] * (RUNS - 3)
    assert not flat(gradient)[:3].any()
    assert not np.asarray(info.multipliers)[:3].any()
    for k in range(3):
        with pytest.raises(ValueError, match="should be finite; found NaN or infinities"):
            direct(values[k], V[k], given[2][k])


@pytest.mark.parametrize("path", ["device", "host"])
def test_no_constraint_is_left_out_for_a_number_that_is_none(path: str) -> None:
    """In `restoring` a slack that is NaN is not ≤ 0, so that the constraint would be off."""
    step, V = ConstrainedStep(formulation="restoring"), np.array([[1.0, 0.0], [-1.0, 1.0]])
    move = jax.jit(lambda values, limits: constrained_direction(values, V, limits, step, path=path))
    for values, limits in (([0.0, 1.0], [np.nan]), ([0.0, np.nan], [0.0]), ([0.0, -np.inf], [0.0])):
        gradient, info = move(np.array(values), np.array(limits))
        assert info.status == Status.NUMERICAL_ERROR
        assert not np.asarray(gradient).any()
        with pytest.raises(ValueError, match="finite"):
            constrained_direction(values, V, limits, step, path=path)


def test_what_float64_cannot_tell_is_uncertified_and_moves_nothing(scan: Any) -> None:
    """Rows 1e-9 rad from opposing: met at 1e9 times the bounds, which the Gramian does not know."""
    V = np.zeros((3, N))
    V[0, 0], V[1, 1], V[2, 1:3] = 1.0, 1.0, (-1.0, 1e-9)
    given = np.ones((RUNS, 3)), np.tile(V, (RUNS, 1, 1)), np.zeros((RUNS, M))
    gradient, info = scan(*given)
    assert (info.status == Status.UNCERTIFIED).all()
    assert not flat(gradient).any()
    assert constrained_direction(np.ones(3), V, np.zeros(M), STEP, path="host")[1].status == Status.OPTIMAL


@pytest.mark.parametrize(
    ("said", "change"),
    [
        ("values should have shape", {"values": np.zeros((1, 3))}),
        ("values should have at least the loss", {"values": np.zeros(0)}),
        ("values should be real numbers; found complex", {"values": np.zeros(3, complex)}),
        ("thresholds should have shape", {"thresholds": np.zeros(3)}),
        ("gradients should have 3 channels as first axis", {"gradients": np.zeros((2, N))}),
        ("gradients should be of real floats; found complex", {"gradients": np.zeros((3, N), complex)}),
        ("gradients should be of real floats; found int", {"gradients": np.zeros((3, N), int)}),
        ("gradients should have at least one array", {"gradients": {}}),
        ("kind should be", {"kind": "costs"}),
        ("path should be", {"path": "gpu"}),
        ("step should be a ConstrainedStep; found None", {"step": None}),
        ("step_size of step should be > 0", {"step": ConstrainedStep(step_size=0)}),
        ("formulation of step on the device", {"step": ConstrainedStep()}),
        ("radius of step should be None", {"step": ConstrainedStep(formulation="linearized", radius=1.0)}),
        ("solver of step should be active-set", {"step": ConstrainedStep(formulation="linearized", solver="nnls")}),
        ("rule of step should be the default", {"step": ConstrainedStep(rule=hysteresis)}),
        ("metric of step should be None", {"step": ConstrainedStep(metric=np.ones(N))}),
        ("on_failure of step should not be 'raise'", {"step": ConstrainedStep(on_failure="raise")}),
    ],
)
def test_what_does_not_fit_is_refused_while_it_is_traced(said: str, change: dict[str, Any]) -> None:
    values, V = draw(6)
    arrays = {"values": values[0], "gradients": V[0], "thresholds": np.zeros(M)}
    settings = {"step": STEP, **{name: each for name, each in change.items() if name not in arrays}}
    arrays.update({name: each for name, each in change.items() if name in arrays})
    with pytest.raises(ValueError, match=said):
        jax.eval_shape(partial(constrained_direction, **settings), **arrays)
