"""The direction's derivative in (g, J, slack): finite differences and rational arithmetic as referees."""

from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax")

import jax.numpy as jnp  # noqa: E402

from cpgrl_opt import ConstrainedStep  # noqa: E402
from cpgrl_opt.jax import constrained_direction  # noqa: E402

M, N = 3, 5
STEPS = {
    "linearized": ConstrainedStep(formulation="linearized", step_size=1.0, restoration_rate=0.5),
    "restoring": ConstrainedStep(formulation="restoring", step_size=1.0, restoration_rate=0.5),
}


def direction(formulation: str, values: Any, V: Any) -> Any:
    """d and μ, (n + m,), of rewards."""
    step = STEPS[formulation]
    gradient, info = constrained_direction(values, V, jnp.zeros(M), step, kind="reward")
    return jnp.concatenate([gradient, info.multipliers])


COMPILED = {name: jax.jit(partial(direction, name)) for name in STEPS}
BACK = {name: jax.jit(jax.jacrev(partial(direction, name), argnums=(0, 1))) for name in STEPS}


@pytest.mark.parametrize("formulation", STEPS)
def test_it_is_what_finite_differences_tell(formulation: str) -> None:
    h, on = 1e-6, 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        values, V = rng.normal(size=1 + M) * 0.5, rng.normal(size=(1 + M, N))
        on += np.count_nonzero(COMPILED[formulation](values, V)[N:])
        found = BACK[formulation](values, V)
        for _ in range(4):
            v, W = rng.normal(size=1 + M), rng.normal(size=(1 + M, N))
            ahead, behind = (COMPILED[formulation](values + s * v, V + s * W) for s in (h, -h))
            expected = (np.asarray(ahead) - behind) / (2 * h)
            moved = np.asarray(found[0]) @ v + np.einsum("kij,ij->k", found[1], W)
            np.testing.assert_allclose(moved, expected, atol=1e-6 * max(1.0, np.abs(expected).max()))
    assert on >= 6


def test_forward_and_reverse_agree_and_batches_are_loops() -> None:
    rng = np.random.default_rng(9)
    values, V = rng.normal(size=(4, 1 + M)), rng.normal(size=(4, 1 + M, N))
    of = partial(direction, "linearized")
    forward = jax.jit(jax.vmap(jax.jacfwd(of, argnums=1)))(values, V)
    for k in range(4):
        np.testing.assert_allclose(forward[k], BACK["linearized"](values[k], V[k])[1], atol=1e-12)


def test_it_is_exact_where_all_numbers_are_small() -> None:
    """One row of g = (3, 1, 0, 0, 0), J = (−2, 1, 0, 0, 0), J d = b: d = g + J(b − Jg)/JJ, by rationals."""
    g, row, b = [Fraction(3), Fraction(1)], [Fraction(-2), Fraction(1)], Fraction(1, 2)
    square, lack = sum(x * x for x in row), b - sum(x * y for x, y in zip(row, g, strict=True))
    mu = lack / square
    delta = [[Fraction(int(i == j)) for j in range(2)] for i in range(2)]
    by_g = [[delta[i][j] - row[i] * row[j] / square for j in range(2)] for i in range(2)]
    by_row = [
        [delta[i][j] * mu + row[i] * (-g[j] / square - 2 * row[j] * lack / square**2) for j in range(2)]
        for i in range(2)
    ]
    V = np.zeros((1 + M, N))
    V[0, :2], V[1, :2] = [-3.0, -1.0], [-2.0, 1.0]  # channel 0 is a loss
    V[2, 3] = V[3, 4] = 1.0
    by_values, by_V = BACK["restoring"](np.array([0.0, -1.0, 1.0, 1.0]), V)
    np.testing.assert_allclose(by_V[:2, 0, :2], np.array(by_g, float), atol=1e-15)  # −d by −g
    np.testing.assert_allclose(-by_V[:2, 1, :2], np.array(by_row, float), atol=1e-15)
    by_bound = [float(x / square) for x in row]
    np.testing.assert_allclose(-by_values[:2, 1], np.multiply(-0.5, by_bound), atol=1e-15)  # b = −½ slack


def test_where_there_is_none_it_is_the_documented_choice_and_never_nan() -> None:
    """Tight rows with μ = 0 are left out, of dependent ones those that the solver did without; infeasible: 0."""
    V = np.zeros((1 + M, N))
    V[0, :2], V[1, 1] = [-1.0, 0.0], 1.0  # d = g lies on the row's bound
    values = np.array([0.0, 0.0, 1.0, 1.0])
    weak = BACK["restoring"](values, V)
    np.testing.assert_array_equal(weak[1][:N, 0], np.eye(N))
    V[0, 1], V[2], V[3] = 1.0, 2.0 * V[1], V[1]  # twice the row
    double = BACK["restoring"](np.zeros(4), V)
    np.testing.assert_allclose(double[1][:N, 0], np.diag([1.0, 0, 1, 1, 1]), atol=1e-15)
    V[2] = -V[1]
    values[1:] = -1.0
    no_way = BACK["restoring"](values, V)
    for found in (*weak, *double, *no_way):
        assert np.isfinite(found).all()
    assert not np.asarray(no_way[1]).any()


def test_on_the_host_it_is_the_same_and_of_other_formulations_an_error() -> None:
    rng = np.random.default_rng(3)
    values, V = rng.normal(size=1 + M) * 0.5, rng.normal(size=(1 + M, N))

    def total(V: Any, step: ConstrainedStep, path: str) -> Any:
        return (constrained_direction(values, V, np.zeros(M), step, kind="reward", path=path)[0] ** 3).sum()

    found = [jax.jit(jax.grad(partial(total, step=STEPS["linearized"], path=path)))(V) for path in ("host", "device")]
    np.testing.assert_allclose(*found, atol=1e-12)
    assert np.abs(found[0]).max() > 0.1
    with pytest.raises(ValueError, match="formulation of step should be restoring or linearized to be differentiated"):
        jax.grad(partial(total, step=ConstrainedStep(formulation="cone"), path="host"))(V)
