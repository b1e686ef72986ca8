"""Any optimiser of optax under constraints: it proposes, and what it proposes is projected in its own metric.

    Δ = what the optimiser would do;   Δ′ = argmin ½‖Δ′ − Δ‖²_H   s.t.   J Δ′ ≥ what the formulation demands

So nothing behind the projection can undo it, momentum and weight decay included.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from ..direction import Status
from ..step import ConstrainedStep
from ._derivative import answer
from ._info import StepInfo, describe, no_info, stop
from ._metric import metric_of
from ._settings import read_step
from ._trees import list_by_name, names_of, read_gradients, real_vector


class ConstrainState(NamedTuple):
    """The optimiser's own state, and what happened in the last update."""

    inner: Any
    info: StepInfo


def constrain(
    optimizer: Any,
    step: ConstrainedStep,
    thresholds: Any,
    *,
    kind: str = "cost",
    metric: Callable[[Any], Any] | None = None,
    b2: float = 0.999,
    eps: float = 1e-8,
    path: str = "device",
) -> Any:
    """An optimiser whose updates keep slack + J·Δθ as large as the step's formulation demands, to first order.

        optimizer = constrain(optax.adam(1e-2), step, thresholds=[0.1, 0.35])
        updates, state = optimizer.update(
            loss_gradient, state, params, constraint_values=costs, constraint_gradients=cost_gradients
        )

    Parameters
    ----------
    optimizer : of optax, the whole chain: what follows a projection may undo it.
    step : `restoring` or `linearized`. Its step_size is not asked for: the optimiser says how far.
    thresholds : (m,) upper limits of costs, lower limits of rewards; or a dict by name, and then `constraint_values`,
        `constraint_gradients` (a dict of trees) and `info` are by name too. `update` takes others as `thresholds`.
    kind : "cost", whose values should be ≤ thresholds, or "reward", ≥.
    metric : a function of the optimiser's state that returns H, a tree of positive arrays as the parameters are; by
        default the optimiser's own, √v̂ + eps where it is Adam or its like, else the identity.
    b2, eps : of that metric, which optax's state does not keep: give your optimiser's where they are no defaults.
    path : as of `constrained_direction`.

    Returns
    -------
    optax.GradientTransformationExtraArgs, whose `update` wants constraint_values (m,), and constraint_gradients, a tree
    of parameters with the m constraints as first axis of every leaf or a list of m trees. Its state has `info`.
    Where nothing is certified the update is 0; where a number is not finite the optimiser's state stays too.

    Raises
    ------
    ValueError
        For what does not fit, while it is traced; where the state has several second moments and no metric is given.
    """
    if not (hasattr(optimizer, "init") and hasattr(optimizer, "update")):
        raise ValueError(f"optimizer should be one of optax; found {optimizer!r}")
    if metric is not None and not callable(metric):
        raise ValueError(f"metric should be a function of the optimiser's state; found {metric!r}")
    if not isinstance(step, ConstrainedStep):
        raise ValueError(f"step should be a ConstrainedStep; found {step!r}")
    if step.radius is not None:
        raise ValueError(f"step should have no radius, since the optimiser says how far; found {step.radius!r}")
    settings = read_step(replace(step, step_size=1.0), path, kind, 1.0)
    if not settings.is_one_problem:
        raise ValueError(f"formulation of step should be restoring or linearized; found {step.formulation!r}")
    names = names_of(thresholds)

    def read(name: str, given: Any, count: int | None = None) -> Any:
        return real_vector(name, given if names is None else list_by_name(name, given, names), count)

    limits = read("thresholds", thresholds)
    if not isinstance(limits, jax.core.Tracer) and not jnp.isfinite(limits).all():
        raise ValueError(f"thresholds should be finite; found {limits}")
    m, inner = len(limits), optax.with_extra_args_support(optimizer)

    def init(params: Any) -> ConstrainState:
        return ConstrainState(inner.init(params), no_info(settings, m, names))

    def update(
        updates: Any,
        state: ConstrainState,
        params: Any = None,
        *,
        constraint_values: Any = None,
        constraint_gradients: Any = None,
        thresholds: Any = None,
        **extra: Any,
    ) -> tuple[Any, ConstrainState]:
        for what, given in {"values": constraint_values, "gradients": constraint_gradients}.items():
            if given is None:
                raise ValueError(f"constraint_{what}= should be given to update; found None")
        values = read("constraint_values", constraint_values, m)
        slack = settings.signs[1] * (values - (limits if thresholds is None else read("thresholds", thresholds, m)))
        if names is not None:
            constraint_gradients = list_by_name("constraint_gradients", constraint_gradients, names)
        rows, _ = read_gradients(
            constraint_gradients, m, "constraint_gradients", like=updates, is_listed=names is not None
        )
        proposed, moved = inner.update(updates, state.inner, params, **extra)
        own, form = jax.tree.flatten(proposed)
        weights = metric_of(moved, proposed, b2, eps) if metric is None else _leaves_of(metric(moved), proposed)
        roots = [jnp.sqrt(part.astype(values.dtype)) for part in weights]

        white = [
            jnp.concatenate([(part * root)[None], row / root]) for part, row, root in zip(own, rows, roots, strict=True)
        ]
        found = answer(settings, white, slack)
        found = stop(found, jnp.stack([jnp.isfinite(part).all() for part in [slack, *own]]).all())
        is_finite = found.status != Status.NUMERICAL_ERROR  # else H may be none either
        moves = [jnp.where(is_finite, part / root, 0.0) for part, root in zip(found.d, roots, strict=True)]
        change = [part.astype(like.dtype) for part, like in zip(moves, own, strict=True)]
        kept = jax.tree.map(lambda new, old: jnp.where(is_finite, new, old), moved, state.inner)
        return jax.tree.unflatten(form, change), ConstrainState(kept, describe(settings, found, slack, names))

    return optax.GradientTransformationExtraArgs(init, update)


def _leaves_of(metric: Any, proposed: Any) -> list[Any]:
    """ValueError where it is no tree as the parameters are."""
    weights, form = jax.tree.flatten(metric)
    shapes, wanted = [*map(jnp.shape, weights)], [*map(jnp.shape, jax.tree.leaves(proposed))]
    if form != jax.tree.structure(proposed) or shapes != wanted:
        raise ValueError(f"metric should return a tree as the parameters are, of shapes {wanted}; found {shapes}")
    return weights
