"""A direction that can be differentiated: by one small KKT solve on the rows with μ > 0.

    d = g + Jᵀμ,  J_A d = b_A,  A = {i : μᵢ > 0}
    u = ġ + J̇ᵀμ,  J_A J_Aᵀ μ̇ = ḃ_A − J̇_A d − J_A u,  ḋ = u + J_Aᵀ μ̇

Where a tight row has μ = 0, and where rows depend, d has no derivative in all directions: this one leaves out the rows
with μ = 0, and those that the solver did without. Of what is not OPTIMAL it is 0.
Source: implicit function theorem; Amos & Kolter 2017, OptNet, §3.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve

from ..direction import Status
from ._certified import Answer, solve
from ._host import solve_on_host
from ._rows import read_channels
from ._settings import Settings

# Least diagonal entry of the Cholesky factor of unit rows, in √eps. Rounding alone leaves about √eps where rows depend:
# below 8 of it a derivative may be noise, with 80 rows 1e-6 rad apart, whose derivative is right, would have none.
_LEAST_PIVOT = 8.0


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _answer(settings: Settings, leaves: list[Any], slack: Any) -> Answer:
    """d of a step, in units of step_size, each leaf (1 + m, …) with g first; its status and residuals as floats."""
    if settings.path == "host":
        return solve_on_host(settings, leaves, slack)
    gives_met = settings.kept is None
    return solve(leaves, settings.bound(slack), signs=settings.signs, tolerance=settings.tolerance, gives_met=gives_met)


@_answer.defjvp
def _differentiate(settings: Settings, given: Any, moves: Any) -> tuple[Answer, Answer]:
    if not settings.is_one_problem:
        found = settings.step.formulation
        raise ValueError(f"formulation of step should be restoring or linearized to be differentiated; found {found!r}")
    (leaves, slack), (leaf_moves, slack_moves) = given, moves
    found = _answer(settings, leaves, slack)
    rows, _ = read_channels(leaves, settings.signs)
    wide = rows.norms.dtype
    is_known = (found.status == Status.OPTIMAL) & jnp.isfinite(found.multipliers).all()
    active = (found.multipliers > 0.0) & is_known
    factor = jnp.linalg.cholesky(jnp.where(active & active[:, None], rows.gramian, jnp.eye(len(active), dtype=wide)))
    is_apart = (jnp.diagonal(factor) > _LEAST_PIVOT * jnp.finfo(wide).eps ** 0.5).all()
    is_sure = is_apart & is_known
    factor = jnp.where(is_sure, factor, jnp.eye(len(active), dtype=wide))

    signs = jnp.where(jnp.arange(1 + len(active)) == 0, *settings.signs).astype(wide)
    weights = signs * jnp.concatenate([jnp.ones(1, wide), jnp.where(active, found.multipliers, 0.0)])
    leaf_moves = [jnp.where(is_sure, leaf, 0).astype(wide) for leaf in leaf_moves]
    wide_d = [d.astype(wide) for d in found.d]
    u = [jnp.tensordot(weights, leaf, 1, precision="highest") for leaf in leaf_moves]
    turned = sum(
        jnp.tensordot(leaf, d, d.ndim, precision="highest") for leaf, d in zip(leaf_moves, wide_d, strict=True)
    )
    turned = signs[1:] * turned[1:]
    asked = jnp.where(is_sure, settings.bound_rate(slack), 0.0) * slack_moves - turned
    per_length = rows.original(jnp.ones_like(rows.norms), 0)
    rest = jnp.where(active, per_length * asked - rows.products(u), 0.0)
    force = jnp.where(active, cho_solve((factor, True), rest), 0.0)
    moved = rows.combine(0.0, force, u)
    d = [move.astype(leaf.dtype) for move, leaf in zip(moved, found.d, strict=True)]
    gain = jnp.where(is_sure, turned + rows.lengthen(rows.products(moved), 0), 0.0)
    still = jnp.zeros_like(found.residuals), jnp.zeros_like(found.status)
    return found, Answer(d, (per_length * force).astype(found.multipliers.dtype), gain.astype(found.gain.dtype), *still)


answer = jax.jit(_answer, static_argnums=0)  # else each eager call would compile its loops anew
