"""What happened in an update."""

from collections.abc import Hashable
from typing import Any, NamedTuple

import jax.numpy as jnp

from ..direction import Status
from ._certified import Answer, tolerance_in
from ._settings import Settings


class StepInfo(NamedTuple):
    """The proof of an update; arrays, so that it goes through `jit`, `vmap` and `scan`.

    The first four are dicts by name where the thresholds came as one.

    multipliers μ: (m,) ≥ 0, what descends is ∇loss + Σ μᵢ∇costᵢ, with rewards −∇rewardᵢ in the place of ∇costᵢ; of
        INFEASIBLE a proof that nothing meets the constraints. Infinite where it leaves the float, as 1e40 does float32.
    active: (m,) the constraints that the step looked at; with `linearized` those with μ > 0.
    slack: (m,) threshold − cost, or reward − threshold; ≥ 0 is feasible.
    predicted_slack: (m,) after the update, to first order, before the update is rounded to the parameters' dtypes.
        Infinite, with its sign, where it leaves the float.
    residuals: (4,) of the certificate, in the order of `KKTResiduals`; infinite where there is none.
    status: an integer, see `Status`. OPTIMAL; INFEASIBLE where nothing meets the constraints, so that they are violated
        least; UNCERTIFIED and NUMERICAL_ERROR where nothing moves.
    tolerance: what OPTIMAL holds the residuals to: the solver's, 1e-9; or 7.6e-6 where JAX has float32 only.
    """

    multipliers: Any
    active: Any
    slack: Any
    predicted_slack: Any
    residuals: Any
    status: Any
    tolerance: Any


def describe(settings: Settings, found: Answer, slack: Any, names: tuple[Hashable, ...] | None) -> StepInfo:
    """The step's change is step_size · d."""
    active = slack <= 0.0 if settings.kept is None else found.multipliers > 0.0
    predicted = slack + float(settings.step.step_size) * found.gain  # type: ignore[arg-type]
    own = found.residuals.dtype if settings.path == "device" else jnp.float64  # the host's is of float64 anyway
    tolerance = jnp.asarray(tolerance_in(own, settings.tolerance), found.residuals.dtype)
    info = StepInfo(found.multipliers, active, slack, predicted, found.residuals, found.status, tolerance)
    return name(info._replace(status=found.status.astype(jnp.int32)), names)


def no_info(settings: Settings, m: int, names: tuple[Hashable, ...] | None) -> StepInfo:
    """Before the first update."""
    zero = jnp.zeros(m, jnp.result_type(float))
    status = jnp.asarray(Status.UNCERTIFIED, zero.dtype)
    nothing = Answer([], zero, zero, jnp.full(4, jnp.inf, zero.dtype), status)
    # Slack of 1, so that no constraint is active.
    info = describe(settings, nothing, zero + 1.0, None)
    return name(info._replace(slack=zero, predicted_slack=zero), names)


def name(info: StepInfo, names: tuple[Hashable, ...] | None) -> StepInfo:
    """The numbers of each constraint by its name."""
    if names is None:
        return info
    fields = StepInfo._fields[:4]
    return info._replace(**{own: {key: getattr(info, own)[i] for i, key in enumerate(names)} for own in fields})


def stop(found: Answer, is_finite: Any) -> Answer:
    """The same, or NUMERICAL_ERROR and zeros where something else is not finite."""
    status = jnp.where(is_finite, found.status, Status.NUMERICAL_ERROR)
    is_answer = status <= Status.INFEASIBLE
    d = [jnp.where(is_answer, leaf, 0) for leaf in found.d]
    mu, gain = (jnp.where(is_answer, each, 0.0) for each in (found.multipliers, found.gain))
    return Answer(d, mu, gain, jnp.where(is_finite, found.residuals, jnp.inf), status)
