"""`constrained_direction`: what stands in the place of the loss's gradient."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..direction import Status
from ..step import ConstrainedStep
from ..validation import require_member
from ._derivative import answer
from ._settings import KINDS, Settings, read_step
from ._trees import read_gradients, real_vector


class ConstrainedDirection(NamedTuple):
    """What descends the loss under the constraints, and its proof; a pytree of arrays.

    gradient: in the place of the loss's: θ − α₁ gradient is the step, α₁ its step_size. 0 where nothing is certified.
    multipliers μ: (m,) ≥ 0, gradient = ∇loss + Σ μᵢ∇costᵢ, with rewards −∇rewardᵢ in the place of ∇costᵢ; of
        INFEASIBLE a proof that nothing meets the constraints.
    active: (m,) the constraints that the step looked at; with `linearized` those with μ > 0.
    slack: (m,) threshold − cost, or reward − threshold; ≥ 0 is feasible. predicted_slack: after the step, to first
        order.
    residuals: (4,) of the certificate, in the order of `KKTResiduals`; infinite where there is none.
    status: an integer, a `Status`.
    """

    gradient: Any
    multipliers: Any
    active: Any
    slack: Any
    predicted_slack: Any
    residuals: Any
    status: Any


def constrained_direction(
    values: Any, gradients: Any, thresholds: Any, step: ConstrainedStep, *, kind: str = "cost", path: str = "device"
) -> ConstrainedDirection:
    """What descends the loss under the constraints; eager or under `jit`, `vmap`, `scan`, `grad`.

        values, gradients = f(θ), jax.jacrev(f)(θ)            f: θ → (1 + m,), the loss and the m costs

    Parameters
    ----------
    values : (1 + m,) the loss, which is not looked at, and the constraints.
    gradients : a tree of parameters with the 1 + m channels as first axis of every leaf, or a list of 1 + m trees.
    thresholds : (m,) upper limits of costs, lower limits of rewards.
    step : how constraints are met; step.step_size is the rate at which the step is exact.
    kind : "cost", whose values should be ≤ thresholds, or "reward", ≥. Channel 0 is a loss with either.
    path : "device", for `restoring` and `linearized`; or "host", by the step itself, which is called back, under `vmap`
        once for the whole batch.

    Raises
    ------
    ValueError
        For shapes, dtypes and settings that do not fit, while it is traced; for numbers that are not finite where it
        is not traced. Under `jit` these have the status NUMERICAL_ERROR.
    """
    settings = read_step(step, path)
    require_member("kind", kind, KINDS)
    values = real_vector("values", values)
    if len(values) == 0:
        raise ValueError("values should have at least the loss; found none")
    limits = real_vector("thresholds", thresholds, len(values) - 1)
    read_gradients(gradients, len(values))
    found = _direct(settings, kind == "cost", values, gradients, limits)
    if not isinstance(found.status, jax.core.Tracer) and int(found.status) == Status.NUMERICAL_ERROR:
        raise ValueError(
            "values, gradients and thresholds should be finite, and the direction; found NaN or infinities"
        )
    return found


@partial(jax.jit, static_argnums=(0, 1))
def _direct(settings: Settings, is_cost: bool, values: Any, gradients: Any, limits: Any) -> ConstrainedDirection:
    leaves, rebuild = read_gradients(gradients, len(values))
    sign = -1.0 if is_cost else 1.0
    slack = sign * (values[1:] - limits)
    signs = jnp.where(jnp.arange(len(values)) == 0, -1.0, sign)[:, None]
    ascent = [leaf * signs.astype(leaf.dtype) for leaf in leaves]
    found = answer(settings, ascent, slack)
    status = jnp.where(jnp.isfinite(values[0]), found.status, Status.NUMERICAL_ERROR).astype(jnp.int32)
    d = [jnp.where(status <= Status.INFEASIBLE, leaf, 0) for leaf in found.d]
    active = found.multipliers > 0.0 if settings.kept is not None else slack <= 0.0
    wide = slack.dtype
    moved = sum(
        jnp.matmul(leaf[1:].astype(wide), part.astype(wide), precision=jax.lax.Precision.HIGHEST)
        for leaf, part in zip(ascent, d, strict=True)
    )
    predicted = slack + float(settings.step.step_size) * moved  # type: ignore[arg-type]
    gradient = rebuild([-leaf for leaf in d])
    return ConstrainedDirection(gradient, found.multipliers, active, slack, predicted, found.residuals, status)
