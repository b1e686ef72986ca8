"""The direction's derivative in (g, J, slack): finite differences and rational arithmetic as referees."""

from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax")

import jax.numpy as jnp  # noqa: E402

from cpgrl_opt import ConstrainedStep, DirectionProblem  # noqa: E402
from cpgrl_opt.exact import exact_answer  # noqa: E402
from cpgrl_opt.exact.rational import dot, fractions_of, solve  # noqa: E402
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


def exact_move(V: np.ndarray, b: np.ndarray, W: np.ndarray, c: np.ndarray) -> tuple[int, list[Fraction]]:
    """How many rows are on, and ḋ where [g; J] and b move by W and c, by the KKT conditions in rationals."""
    found = exact_answer(DirectionProblem(V[0], V[1:], b))
    (g, *J), (moved_g, *moved_J), (bound, moved) = (
        *([fractions_of(row) for row in A] for A in (V, W)),
        map(fractions_of, (b, c)),
    )
    on = [i for i in range(len(J)) if found.multipliers[i] > 0.0]
    K = [[dot(J[i], J[j]) for j in on] for i in on]
    mu = solve(K, [bound[i] - dot(J[i], g) for i in on]) or []
    d = [x + sum(y * J[i][k] for y, i in zip(mu, on, strict=True)) for k, x in enumerate(g)]
    u = [x + sum(y * moved_J[i][k] for y, i in zip(mu, on, strict=True)) for k, x in enumerate(moved_g)]
    force = solve(K, [moved[i] - dot(moved_J[i], d) - dot(J[i], u) for i in on]) or []
    return len(on), [x + sum(y * J[i][k] for y, i in zip(force, on, strict=True)) for k, x in enumerate(u)]


def test_it_is_what_rational_arithmetic_says() -> None:
    """Integers of one digit, of which rows nearly depend now and then."""
    move = jax.jit(lambda v, V, w, W: jax.jvp(partial(direction, "restoring"), (v, V), (w, W))[1])
    counts = set()
    for seed in range(12):
        rng = np.random.default_rng(seed)
        V, W = rng.integers(-5, 6, (2, 1 + M, N)).astype(float)
        slack, w = -rng.integers(1, 5, M).astype(float), rng.integers(-4, 5, M).astype(float)
        count, expected = exact_move(V, -0.5 * slack, W, -0.5 * w)
        counts.add(count)
        turn = np.array([-1.0, 1.0, 1.0, 1.0])[:, None]  # channel 0 is a loss
        found = -move(np.insert(slack, 0, 0.0), turn * V, np.insert(w, 0, 0.0), turn * W)[:N]
        scale = max(1.0, *(abs(float(x)) for x in expected))
        np.testing.assert_allclose(found, [float(x) for x in expected], atol=1e-12 * scale)
    assert counts == {0, 1, 2}


@pytest.mark.parametrize("angle", [1e-1, 1e-2])
def test_in_float32_it_is_right_or_0(angle: float) -> None:
    """Two rows an angle apart, both on: ḋ is 0 in their plane; rounding of the Gramian never shows as a derivative."""
    jax.config.update("jax_enable_x64", False)
    V = np.zeros((1 + M, N), "float32")
    V[0, :3] = [1.0, 0.0, 1.0]  # a loss: g = −V[0]
    # d has 0.05 and 0.5 angle in the plane, so that both multipliers are about 0.5 at any angle.
    V[1, :2], V[2, :2], V[3, 3] = [1.0, 0.0], [np.cos(angle), np.sin(angle)], 1.0
    values = np.array([0.0, -0.1, -0.1 * np.cos(angle) - angle * np.sin(angle), 1.0], "float32")
    by_g = jax.jit(jax.jacfwd(lambda g: direction("restoring", values, jnp.asarray(V).at[0].set(g))))(V[0])[:N]
    expected = np.diag([0.0, 0.0, 1.0, 1.0, 1.0])
    assert np.abs(by_g - expected).max() <= 1e-3 or not np.asarray(by_g).any()
    if angle >= 1e-1:
        assert np.asarray(by_g).any()


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
