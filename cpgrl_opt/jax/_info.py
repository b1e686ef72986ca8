"""What happened in an update."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from ..direction import Status
from ._certified import Answer
from ._settings import Settings


class StepInfo(NamedTuple):
    """The proof of an update; arrays, so that it goes through `jit`, `vmap` and `scan`.

    multipliers μ: (m,) ≥ 0, what descends is ∇loss + Σ μᵢ∇costᵢ, with rewards −∇rewardᵢ in the place of ∇costᵢ; of
        INFEASIBLE a proof that nothing meets the constraints.
    active: (m,) the constraints that the step looked at; with `linearized` those with μ > 0.
    slack: (m,) threshold − cost, or reward − threshold; ≥ 0 is feasible.
    predicted_slack: (m,) after the update, to first order.
    residuals: (4,) of the certificate, in the order of `KKTResiduals`; infinite where there is none.
    status: an integer, see `Status`. OPTIMAL; INFEASIBLE where nothing meets the constraints, so that they are violated
        least; UNCERTIFIED and NUMERICAL_ERROR where nothing moves.
    """

    multipliers: Any
    active: Any
    slack: Any
    predicted_slack: Any
    residuals: Any
    status: Any


def describe(settings: Settings, found: Answer, slack: Any, gain: Any) -> StepInfo:
    """gain: J times the change."""
    active = slack <= 0.0 if settings.kept is None else found.multipliers > 0.0
    status = found.status.astype(jnp.int32)
    return StepInfo(found.multipliers, active, slack, slack + gain, found.residuals, status)


def no_info(m: int) -> StepInfo:
    """Before the first update."""
    zero = jnp.zeros(m, jnp.result_type(float))
    nothing = jnp.full(4, jnp.inf, zero.dtype), jnp.asarray(Status.UNCERTIFIED, jnp.int32)
    return StepInfo(zero, jnp.zeros(m, bool), zero, zero, *nothing)


def gain_of(rows: list[Any], d: list[Any]) -> Any:
    """J d, of leaves (m, k) and (k,)."""
    wide = jnp.result_type(float)
    products = (
        jnp.matmul(row.astype(wide), part.astype(wide), precision=lax.Precision.HIGHEST)
        for row, part in zip(rows, d, strict=True)
    )
    return sum(products)


def stop(found: Answer, is_finite: Any) -> Answer:
    """The same, or NUMERICAL_ERROR and zeros where something else, or a multiplier in this float, is not finite."""
    is_finite &= jnp.isfinite(found.multipliers).all()
    status = jnp.where(is_finite, found.status, Status.NUMERICAL_ERROR)
    is_answer = status <= Status.INFEASIBLE
    d = [jnp.where(is_answer, leaf, 0) for leaf in found.d]
    mu = jnp.where(is_answer, found.multipliers, 0.0)
    return Answer(d, mu, jnp.where(is_finite, found.residuals, jnp.inf), status)
