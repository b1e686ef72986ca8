"""`constrained_direction`: what stands in the place of the loss's gradient."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from ..direction import Status
from ..step import ConstrainedStep
from ._derivative import answer
from ._info import StepInfo, describe, name, stop
from ._settings import Settings, read_step
from ._trees import list_by_name, names_of, read_gradients, real_vector, split_by_name


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
    thresholds : (m,) upper limits of costs, lower limits of rewards; or a dict by name. Then values are a pair of the
        loss and a dict, gradients a pair of a tree and a dict of trees, as `jacrev` makes them, and so is `info`.
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
    settings = read_step(step, path, kind, -1.0)
    names = names_of(thresholds)
    if names is not None:
        thresholds = list_by_name("thresholds", thresholds, names)
        values = split_by_name("values", values, names)
        gradients = split_by_name("gradients", gradients, names)
    values = real_vector("values", values)
    if len(values) == 0:
        raise ValueError("values should have at least the loss; found none")
    limits = real_vector("thresholds", thresholds, len(values) - 1)
    leaves, rebuild = read_gradients(gradients, len(values), is_listed=names is not None)
    gradient, info = _solve(settings, values, leaves, limits)
    if not isinstance(info.status, jax.core.Tracer) and int(info.status) == Status.NUMERICAL_ERROR:
        raise ValueError("values, gradients, thresholds and the direction should be finite; found NaN or infinities")
    return rebuild(gradient), name(info, names)


@partial(jax.jit, static_argnums=0)
def _solve(settings: Settings, values: Any, leaves: list[Any], limits: Any) -> tuple[list[Any], StepInfo]:
    """What descends, in leaves."""
    slack = settings.signs[1] * (values[1:] - limits)
    found = stop(answer(settings, leaves, slack), jnp.isfinite(values).all() & jnp.isfinite(slack).all())
    return [0.0 - leaf for leaf in found.d], describe(settings, found, slack, None)  # −leaf would make −0.0 of 0
