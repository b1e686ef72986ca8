"""Projections on the device: pivots in small coordinates, refined by products with the vectors themselves.

    d = argmin ½‖d − g‖²  s.t.  Ĵd ≥ b̂          hard rows
    d = argmin ½‖d − g‖² + ½ Σ (b̂ᵢ − Ĵᵢd)₊²/εᵢ   where εᵢ > 0, rows that give

The Gramian loses digits as eps/θ² for rows θ from opposing each other; each round asks for what is left of the slack
as the vectors tell it, so that what it loses shrinks by that factor.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from ._pivoting import Pivots, find_active_set, no_pivots
from ._rows import Leaves, Rows, add, length

# Two do where rows are 1e-3 rad apart, four down to about 1e-6; below that rounds do not help.
_ROUNDS = 5
_GOOD = 8  # of a slack that should be 0, in eps of the longer of d and g: what a product rounds to


class Projection(NamedTuple):
    """d with the pivots that it comes from, its slack Ĵd + εμ − b̂, and ‖d‖."""

    d: Leaves
    pivots: Pivots
    slack: Any
    length: Any


class _Round(NamedTuple):
    now: Projection
    is_good: Any
    count: Any


def project(rows: Rows, gradient: Leaves, bound: Any, soft: Any) -> Projection:
    """bound: (m,) of unit rows, −∞ where a row is off; soft: ε, 0 where a row is hard."""
    takes_part = rows.moves & (bound > -jnp.inf)
    asked = jnp.where(takes_part, bound, 0.0)
    K, eps = rows.gramian + jnp.diag(soft), jnp.finfo(asked.dtype).eps

    def look(d: Leaves, pivots: Pivots) -> Projection:
        return Projection(d, pivots, rows.products(d) + soft * pivots.multipliers - asked, length(d))

    def improve(step: _Round) -> _Round:
        now = step.now
        pivots = find_active_set(K, now.slack, takes_part, now.pivots)
        new = look(add(now.d, rows.combine(pivots.multipliers - now.pivots.multipliers)), pivots)
        off = jnp.where(pivots.active, jnp.abs(new.slack), jnp.where(takes_part, -new.slack, 0.0))
        is_good = ~(off.max(initial=0.0) > _GOOD * eps * jnp.maximum(unit, new.length)) | (pivots.proof > 0.0).any()
        return _Round(new, is_good, step.count + 1)

    first = look(gradient, no_pivots(K))
    unit = jnp.maximum(first.length, asked.max(initial=0.0))
    begin = _Round(first, jnp.asarray(False), 0)
    return lax.while_loop(lambda s: ~s.is_good & (s.count < _ROUNDS), improve, begin).now
