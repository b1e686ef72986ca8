"""`constrained_direction` is the step that NumPy's users get, under whatever transformation of JAX."""

from functools import cache, partial
from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax")

import jax.numpy as jnp  # noqa: E402

from cpgrl_opt import ConstrainedStep, Linearization, Status  # noqa: E402
from cpgrl_opt.jax import constrained_direction  # noqa: E402
from cpgrl_opt.problems import FAMILIES, Case  # noqa: E402
from cpgrl_opt.step_result import StepResult  # noqa: E402

RUNS, M, N = 16, 3, 9
STEPS = {
    # s meets J s ≥ −slack: any bounds that a family draws
    "linearized": ConstrainedStep(formulation="linearized", step_size=1.0, restoration_rate=1.0),
    "restoring": ConstrainedStep(formulation="restoring", step_size=0.5, restoration_rate=0.25),
}
CLOSE = 1e-9  # ‖d − d'‖ over the larger of ‖g‖ and ‖d‖; 1e-15 but for rows 1e-7 rad from opposing


def tree(V: Any) -> Any:
    """(…, 9) → leaves of several shapes, one of them empty."""
    head = V[..., :6].reshape(*V.shape[:-1], 2, 3)
    return {"head": head, "none": V[..., :0], "rest": (V[..., 6:],)}


def flat(grown: Any) -> np.ndarray:
    head = np.asarray(grown["head"])
    return np.concatenate([head.reshape(*head.shape[:-2], 6), np.asarray(grown["rest"][0])], axis=-1)


@cache
def directions(formulation: str, path: str) -> Any:
    """One compiled call for 16 problems of rewards."""
    given = {"step": STEPS[formulation], "kind": "reward", "path": path}
    return jax.jit(jax.vmap(partial(constrained_direction, **given), in_axes=(0, 0, None)))


def draw(family: str, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Channels and bounds of 16 problems; a family that does not come in this shape is skipped."""
    try:
        drawn = [FAMILIES[family].draw(np.random.default_rng(k), case, n=N, m=M) for k in range(RUNS)]
    except ValueError as error:
        pytest.skip(str(error))
    # Some come in fewer parameters or constraints: the rest are zeros, and switched off.
    V, bound = np.zeros((RUNS, 1 + M, N)), np.full((RUNS, M), -np.inf)
    for k, p in enumerate(drawn):
        V[k, : 1 + p.m, : p.n], bound[k, : p.m] = np.vstack([p.gradient, p.jacobian]), p.bound
    return V, bound


def by_step(step: ConstrainedStep, V: np.ndarray, slack: np.ndarray) -> StepResult:
    return step(Linearization(np.insert(slack, 0, 0.0, axis=-1), V), np.zeros(slack.shape[-1]))


def ask(formulation: str, path: str, V: np.ndarray, slack: np.ndarray) -> Any:
    turned = np.concatenate([-V[:, :1], V[:, 1:]], axis=1)  # channel 0 is a loss
    values = np.insert(slack, 0, 0.0, axis=1).astype(V.dtype)
    given = jnp.asarray(values), tree(jnp.asarray(turned)), jnp.zeros(slack.shape[1], V.dtype)
    return directions(formulation, path)(*given)


def statuses(result: StepResult) -> np.ndarray:
    skipped, infeasible = result.counts["skipped"] > 0, result.counts["infeasible"] > 0
    return np.where(skipped, Status.UNCERTIFIED, np.where(infeasible, Status.INFEASIBLE, Status.OPTIMAL))


@pytest.mark.parametrize("formulation", STEPS)
@pytest.mark.parametrize("family", [name for name, each in FAMILIES.items() if each.geometry is None])
def test_families_are_answered_as_by_the_step(family: str, formulation: str) -> None:
    for case in (Case.CONE, Case.BOUNDS):
        if case not in FAMILIES[family].cases:
            continue
        V, bound = draw(family, case)
        slack = np.where(np.isfinite(bound), -bound, 1e3)
        expected, (gradient, found) = by_step(STEPS[formulation], V, slack), ask(formulation, "device", V, slack)
        status, step_size = np.asarray(found.status), STEPS[formulation].step_size
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
        same = status == statuses(expected)
        if family in ("weakly infeasible", "almost opposing"):  # to the tolerance, or in a float, nothing tells
            assert same.mean() >= 0.5
        else:
            assert same.all()
        difference = flat(gradient) + expected.change / step_size
        size = np.maximum(np.linalg.norm(V[:, 0], axis=1), np.linalg.norm(expected.change / step_size, axis=1))
        certain = same & (family != "almost opposing")
        assert (np.linalg.norm(difference, axis=1) <= CLOSE * size)[certain].all()
        if formulation == "restoring":  # of `linearized` they are those with μ > 0, which dependent rows leave open
            np.testing.assert_array_equal(found.active, expected.active)
        optimal = status == Status.OPTIMAL
        assert np.asarray(found.residuals)[optimal].max(initial=0.0) <= 1e-9
        moved = -step_size * V[:, 1:] * flat(gradient)[:, None]
        rounding = 1e-13 * (np.abs(slack) + np.abs(moved).sum(axis=2))
        assert (np.abs(found.predicted_slack - slack - moved.sum(axis=2)) <= rounding).all()
