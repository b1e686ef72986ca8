"""The small problem on the device: min ½ μᵀKμ − (b − c)ᵀμ, μ ≥ 0, by principal pivots of K; m × m numbers, no n.

    w = c + Kμ − b ≥ 0,   μ ≥ 0,   μᵀw = 0        K = ĴĴᵀ, c = Ĵg: then d = g + Ĵᵀμ has Ĵd − b = w

T is K with the rows that are on exchanged: of w_A and μ_A each is read off the other. A row that depends on those that
are on either takes one's place, or proves that nothing meets the bounds.
Source: Goldfarb & Idnani 1983; Cottle, Pang & Stone, The Linear Complementarity Problem, §4.1 (principal pivots).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

# Of 1 − Ĵᵢ's part along the rows that are on, in eps: less is what rounding leaves of a row that depends on them. With
# 1 rows that sum to zero span a direction of their own; with 100 rows 1e-7 rad apart are one.
_DEPENDS = 16
# Of a slack, in eps: with 2 rows come on and go off for rounding alone, up to the limit; with 1000 a violation that the
# next round would mend stays.
_ROUNDING = 32


class Pivots(NamedTuple):
    """μ (m,), which rows are on, T, and y, where it is not 0 a proof that nothing meets the bounds."""

    multipliers: Any
    active: Any
    table: Any
    proof: Any


class _Search(NamedTuple):
    at: Pivots
    is_done: Any
    count: Any


def no_pivots(gramian: Any) -> Pivots:
    """Where a search begins: no row is on."""
    zero = jnp.zeros(len(gramian), gramian.dtype)
    return Pivots(zero, zero > 1, gramian, zero)


def find_active_set(gramian: Any, slack: Any, takes_part: Any, start: Pivots) -> Pivots:
    """μ ≥ 0 with w ≥ 0, or a proof y.

    slack: w at the start's μ. takes_part: the rows that may come on.
    """
    m, eps = len(slack), jnp.finfo(slack.dtype).eps
    at = jnp.arange(m)

    def choose(search: _Search) -> _Search:
        mu, active, table, proof = search.at
        w = slack + _multiply(gramian, mu - start.multipliers)
        move = jnp.where(active, -_multiply(table, jnp.where(active, w, 0.0)), 0.0)
        is_blocking = active & (mu + move < 0.0)
        part, first = _least(jnp.where(is_blocking, mu / jnp.where(is_blocking, -move, 1.0), jnp.inf))
        is_blocked = jnp.isfinite(part)
        mu = mu + jnp.where(is_blocked, part, 1.0) * move
        w = slack + _multiply(gramian, mu - start.multipliers)

        rounding = _ROUNDING * eps * (1.0 + jnp.abs(mu - start.multipliers).sum())
        worst, enters = _least(jnp.where(takes_part & ~active, w, jnp.inf))
        is_met = ~(worst < -rounding)
        is_new = at == enters
        column = jnp.where(is_new, table, 0.0).sum(axis=1)
        along = jnp.where(active, -column, 0.0)
        own = jnp.where(is_new, column, 0.0).sum()
        depends = own <= _DEPENDS * eps * (1.0 + jnp.abs(along).sum()) ** 2
        room, second = _least(jnp.where(along > _ROUNDING * eps, mu / jnp.where(along > 0.0, along, 1.0), jnp.inf))
        is_proven = ~is_blocked & ~is_met & depends & ~jnp.isfinite(room)

        goes_on = ~is_blocked & ~is_met & ~is_proven
        trades = goes_on & depends
        step = jnp.where(trades, room, 0.0)
        mu = mu - step * along + jnp.where(is_new, step, 0.0)
        leaves = jnp.where(is_blocked, first, second)
        goes = (at == leaves) & (is_blocked | trades)
        comes = is_new & goes_on
        table = _exchange(_exchange(table, goes), comes)
        found = Pivots(jnp.where(goes, 0.0, mu), (active & ~goes) | comes, table, proof)
        y = jnp.maximum(jnp.where(is_new, 1.0, -along), 0.0)
        found = found._replace(proof=jnp.where(is_proven, y, proof))
        return _Search(found, ~is_blocked & (is_met | is_proven), search.count + 1)

    if m == 0:
        return start
    begin = _Search(start, jnp.asarray(False), 0)
    limit = 10 + 8 * m  # each row comes on once or twice; rounding may have rows come and go for ever
    return lax.while_loop(lambda s: ~s.is_done & (s.count < limit), choose, begin).at


def _multiply(matrix: Any, x: Any) -> Any:
    """As sums, which are compiled into the kernels around them; a product of its own takes longer than all of these."""
    return (matrix * x).sum(axis=1)


def _least(values: Any) -> tuple[Any, Any]:
    """The least and where it is first, in one pass."""

    def choose(a: Any, b: Any) -> tuple[Any, Any]:
        is_first = (a[0] < b[0]) | ((a[0] == b[0]) & (a[1] < b[1]))
        return jnp.where(is_first, a[0], b[0]), jnp.where(is_first, a[1], b[1])

    end = jnp.asarray(jnp.inf, values.dtype), jnp.asarray(len(values), jnp.int32)
    return lax.reduce((values, jnp.arange(len(values), dtype=jnp.int32)), end, choose, (0,))


def _exchange(table: Any, is_k: Any) -> Any:
    """w_k for μ_k and the other way round, where `is_k` names a row k; the same again undoes it."""
    here = is_k[:, None] & is_k
    pivot = jnp.where(is_k.any(), jnp.where(here, table, 0.0).sum(), 1.0)
    column, row = (jnp.where(mask, table, 0.0).sum(axis=axis) for mask, axis in ((is_k, 1), (is_k[:, None], 0)))
    new = table - column[:, None] * row / pivot
    new = jnp.where(is_k[:, None], -row / pivot, jnp.where(is_k, (column / pivot)[:, None], new))
    return jnp.where(is_k.any(), jnp.where(here, 1.0 / pivot, new), table)
