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
from ._rows import add, read_channels
from ._settings import Settings

# Least diagonal entry of the Cholesky factor of unit rows, in √eps. Rounding alone leaves about √eps where rows depend:
# below 8 of it a derivative may be noise, with 80 rows 1e-6 rad apart, whose derivative is right, would have none.
_LEAST_PIVOT = 8.0


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _answer(settings: Settings, leaves: list[Any], slack: Any) -> Answer:
    """d of a step, in units of step_size, each leaf (1 + m, k) with g first; its status and residuals as floats."""
    if settings.path == "host":
        return solve_on_host(settings.step, leaves, slack)
    gives_met = settings.kept is None
    return solve(leaves, settings.bound(slack), tolerance=settings.tolerance, gives_met=gives_met)


@_answer.defjvp
def _differentiate(settings: Settings, given: Any, moves: Any) -> tuple[Answer, Answer]:
    if not settings.is_one_problem:
        found = settings.step.formulation
        raise ValueError(f"formulation of step should be restoring or linearized to be differentiated; found {found!r}")
    (leaves, slack), (leaf_moves, slack_moves) = given, moves
    found = _answer(settings, leaves, slack)
    _, _, rows, _ = read_channels(leaves)
    wide = rows.norms.dtype
    active = (found.multipliers > 0.0) & (found.status == Status.OPTIMAL)
    factor = jnp.linalg.cholesky(jnp.where(active & active[:, None], rows.gramian, jnp.eye(len(active), dtype=wide)))
    is_apart = (jnp.diagonal(factor) > _LEAST_PIVOT * jnp.finfo(wide).eps ** 0.5).all()
    is_sure = is_apart & (found.status == Status.OPTIMAL)
    factor = jnp.where(is_sure, factor, jnp.eye(len(active), dtype=wide))

    mu = jnp.where(active, found.multipliers, 0.0)
    leaf_moves = [jnp.where(is_sure, leaf, 0).astype(wide) for leaf in leaf_moves]
    u = [leaf[0] + mu @ leaf[1:] for leaf in leaf_moves]
    turned = sum(leaf[1:] @ d.astype(wide) for leaf, d in zip(leaf_moves, found.d, strict=True))
    asked = jnp.where(is_sure, settings.bound_rate(slack), 0.0) * slack_moves - turned
    per_length = rows.original(jnp.ones_like(rows.norms), 0)
    rest = jnp.where(active, per_length * asked - rows.products(u), 0.0)
    force = cho_solve((factor, True), rest)
    force = jnp.where(active, force, 0.0)
    d = [move.astype(leaf.dtype) for move, leaf in zip(add(u, rows.combine(force)), found.d, strict=True)]
    still = jnp.zeros_like(found.residuals), jnp.zeros_like(found.status)
    return found, Answer(d, (per_length * force).astype(found.multipliers.dtype), *still)


answer = jax.jit(_answer, static_argnums=0)  # else each eager call would compile its loops anew
