"""Sums of products over leaves (channels, …) as they lie: no copy, no reshape, so that shards stay where they are.

XLA's product of a few long rows takes ten times as long on a CPU as reading them does, in float64 or from float32. So
there all sums of one row run in one loop. Of short leaves one sum for all pairs is one kernel, under `vmap` too.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

# Entries of a row: below, one kernel for all rows; above, a loop a few rows. A loop compiles for a tenth of a second.
LONG = 2**14
_MOST_ROWS = 8  # with 16 the loops compile for seconds, and XLA's own product is as fast
_ROWS_AT_ONCE = 3  # one, two, three took 60, 32, 28 ms of 10⁶ numbers in six rows; more compile for longer


def gramian(leaf: Any, scales: Any, wide: Any) -> Any:
    """VVᵀ, V = scales · leaf, (channels, channels)."""
    if not _is_looped(leaf):
        V = leaf.astype(wide) * _beside(scales, leaf)
        if leaf.size >= LONG:
            axes = tuple(range(1, leaf.ndim))
            return jnp.tensordot(V, V, (axes, axes), precision=lax.Precision.HIGHEST)
        return jnp.sum(V[:, None] * V[None], tuple(range(2, 1 + leaf.ndim)))
    V, count = [row.astype(wide) * scale for row, scale in zip(leaf, scales, strict=True)], len(leaf)
    pairs = [
        [(i, j) for i in range(k, min(k + _ROWS_AT_ONCE, count)) for j in range(i + 1)]
        for k in range(0, count, _ROWS_AT_ONCE)
    ]
    sums = {
        pair: each for some in pairs for pair, each in zip(some, _add_up([V[i] * V[j] for i, j in some]), strict=True)
    }
    return jnp.stack([jnp.stack([sums[max(i, j), min(i, j)] for j in range(count)]) for i in range(count)])


def products(leaf: Any, scales: Any, d: Any) -> Any:
    """[V d, d·d], (channels + 1,), of a leaf (channels, …) and d in the widest float."""
    if not _is_looped(leaf):
        V = jnp.concatenate([leaf.astype(d.dtype) * _beside(scales, leaf), d[None]])
        if leaf.size >= LONG:
            return jnp.tensordot(V, d, d.ndim, precision=lax.Precision.HIGHEST)
        return jnp.sum(V * d, tuple(range(1, leaf.ndim)))
    rows = [row.astype(d.dtype) * scale * d for row, scale in zip(leaf, scales, strict=True)]
    return jnp.stack(_add_up([*rows, d * d]))


def combine(leaf: Any, scales: Any, weights: Any, start: Any) -> Any:
    """start + Vᵀweights, row by row: each is read once."""
    for row, scale, weight in zip(leaf, scales, weights, strict=True):
        start = start + row.astype(weights.dtype) * scale * weight
    return start


def largest(leaf: Any, wide: Any) -> Any:
    """Largest entry of each channel; NaN where one is NaN."""
    return jnp.abs(leaf.astype(wide)).max(tuple(range(1, leaf.ndim)), initial=0.0)


def _is_looped(leaf: Any) -> bool:
    return leaf.size >= LONG * len(leaf) and len(leaf) <= _MOST_ROWS and jax.default_backend() == "cpu"


def _beside(numbers: Any, leaf: Any) -> Any:
    return numbers.reshape(-1, *(1,) * (leaf.ndim - 1))


def _add_up(terms: Sequence[Any]) -> list[Any]:
    """Sums of arrays of one shape, in one loop."""
    zeros = [jnp.zeros((), term.dtype) for term in terms]
    return lax.reduce(list(terms), zeros, lambda a, b: [x + y for x, y in zip(a, b, strict=True)], range(terms[0].ndim))
