"""Projections on the device: pivots in small coordinates, refined by products with the vectors themselves.

    d = argmin ½‖d − v‖²  s.t.  Ĵd ≥ b̂          hard rows
    d = argmin ½‖d − v‖² + ½ Σ (b̂ᵢ − Ĵᵢd)₊²/εᵢ   where εᵢ > 0, rows that give

The Gramian loses digits as eps/θ² for rows θ from opposing each other; each round asks for what is left of the slack
as the vectors tell it, so that what it loses shrinks by that factor.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from ._pivoting import Pivots, find_active_set, no_pivots
from ._rows import Rows, Vector

# Two do where rows are 1e-3 rad apart, four down to about 1e-6; below that rounds do not help.
_ROUNDS = 5
_GOOD = 8  # of a slack that should be 0, in eps of the longer of d and g: what a product rounds to


class Projection(NamedTuple):
    """d with the pivots that it comes from, its slack Ĵd + εμ − b̂, and the rounds that it took."""

    at: Vector
    pivots: Pivots
    slack: Any
    rounds: Any


def project(rows: Rows, part: Any, goes_on: Any, before: Vector, bound: Any, soft: Any) -> Projection:
    """Of v = part · ĝ, or of `before` where it goes on.

    bound: (m,) of unit rows, −∞ where a row is off; soft: ε, 0 where a row is hard.
    """
    takes_part = rows.moves & (bound > -jnp.inf)
    asked = jnp.where(takes_part, bound, 0.0)
    K, eps, none = rows.gramian + jnp.diag(soft), jnp.finfo(asked.dtype).eps, jnp.zeros_like(asked)
    unit = jnp.maximum(jnp.where(goes_on, before.length, part * rows.length), asked.max(initial=0.0))

    def improve(now: Projection) -> Projection:
        is_first = now.rounds == 0
        pivots = find_active_set(K, now.slack, takes_part, now.pivots)
        # The first round makes d of v, the others mend it: their corrections are small, and so is what they round.
        start = [jnp.where(is_first & ~goes_on, 0.0, leaf) for leaf in now.at.leaves]
        d = rows.combine(jnp.where(is_first & ~goes_on, part, 0.0), pivots.multipliers - now.pivots.multipliers, start)
        new = rows.look(d)
        return Projection(new, pivots, new.along + soft * pivots.multipliers - asked, now.rounds + 1)

    def is_open(now: Projection) -> Any:
        off = jnp.where(now.pivots.active, jnp.abs(now.slack), jnp.where(takes_part, -now.slack, 0.0))
        is_off = off.max(initial=0.0) > _GOOD * eps * jnp.maximum(unit, now.at.length)
        is_good = ~is_off | (now.pivots.proof > 0.0).any()
        return (now.rounds == 0) | (~is_good & (now.rounds < _ROUNDS))

    along = jnp.where(goes_on, before.along, part * rows.along)
    start = Projection(before, no_pivots(K), jnp.where(takes_part, along, none) - asked, 0)
    return lax.while_loop(is_open, improve, start)
