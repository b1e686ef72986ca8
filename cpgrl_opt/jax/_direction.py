"""`constrained_direction`: what stands in the place of the loss's gradient."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from ..direction import Status
from ..step import ConstrainedStep
from ..validation import require_member
from ._derivative import answer
from ._info import StepInfo, describe, gain_of, stop
from ._settings import KINDS, Settings, read_step
from ._trees import read_gradients, real_vector


def constrained_direction(
    values: Any, gradients: Any, thresholds: Any, step: ConstrainedStep, *, kind: str = "cost", path: str = "device"
) -> tuple[Any, StepInfo]:
    """What descends the loss under the constraints; eager or under `jit`, `vmap`, `scan`, `grad`.

        values, gradients = f(θ), jax.jacrev(f)(θ)            f: θ → (1 + m,), the loss and the m costs
        gradient, info = constrained_direction(values, gradients, thresholds, step)

    Parameters
    ----------
    values : (1 + m,) the loss, of which nothing is asked but to be finite, and the constraints.
    gradients : a tree of parameters with the 1 + m channels as first axis of every leaf, or a list of 1 + m trees.
    thresholds : (m,) upper limits of costs, lower limits of rewards.
    step : how constraints are met. step.step_size α₁ is the rate at which it is exact: θ − α₁ gradient.
    kind : "cost", whose values should be ≤ thresholds, or "reward", ≥. Channel 0 is a loss with either.
    path : "device", for `restoring` and `linearized`; or "host", by the step itself, which is called back, under `vmap`
        once for the whole batch.

    Returns
    -------
    gradient : in the place of the loss's, a tree of parameters; −change/α₁. 0 where nothing is certified.
    info : multipliers, active set, slack, predicted slack, residuals, status.

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
    leaves, rebuild = read_gradients(gradients, len(values))
    d, info = _solve(settings, -1.0 if kind == "cost" else 1.0, values, leaves, limits)
    if not isinstance(info.status, jax.core.Tracer) and int(info.status) == Status.NUMERICAL_ERROR:
        raise ValueError("values, gradients, thresholds and the direction should be finite; found NaN or infinities")
    return rebuild([-leaf for leaf in d]), info


@partial(jax.jit, static_argnums=0)
def _solve(settings: Settings, sign: Any, values: Any, leaves: list[Any], limits: Any) -> tuple[list[Any], StepInfo]:
    """What climbs, in leaves. sign: of the constraints, −1 for costs."""
    signs = jnp.where(jnp.arange(len(values)) == 0, -1.0, sign)[:, None]
    ascent = [leaf * signs.astype(leaf.dtype) for leaf in leaves]
    slack = sign * (values[1:] - limits)
    found = stop(answer(settings, ascent, slack), jnp.isfinite(values).all() & jnp.isfinite(slack).all())
    gain = gain_of([leaf[1:] for leaf in ascent], found.d)
    info = describe(settings, found, slack, float(settings.step.step_size) * gain)  # type: ignore[arg-type]
    return found.d, info
