"""Rows on the device, as leaves (m, k) of the parameters' tree: products and combinations, and the unit of each row.

Rows are scaled by powers of two, so that lengths of 1e±100 neither over- nor underflow inside; their lengths are kept.
Products are of the widest float that there is: float64 where JAX has it enabled, else float32.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

Leaves = list[Any]  # a vector, (k,) each


class Rows(NamedTuple):
    """Ĵᵢ = rowᵢ of the leaves / normsᵢ, of length 1, and K̂ = ĴĴᵀ; the lengths are norms · 2^exponents.

    A row that is 0 is not `moves`, has norm 1, and 1 on the diagonal of K̂.
    """

    leaves: Leaves
    norms: Any
    exponents: Any
    moves: Any
    gramian: Any

    def products(self, d: Leaves) -> Any:
        """Ĵd, (m,)."""
        return sum(map(_multiply, self.leaves, d)) / self.norms

    def combine(self, weights: Any) -> Leaves:
        """Ĵᵀweights."""
        scaled = weights / self.norms
        return [_multiply(scaled, leaf) for leaf in self.leaves]

    def per_length(self, values: Any, exponent: Any) -> Any:
        """Bounds bᵢ/‖Jᵢ‖ in units of 2^exponent."""
        return jnp.ldexp(values.astype(self.norms.dtype), -self.exponents - exponent) / self.norms

    def original(self, multipliers: Any, exponent: Any) -> Any:
        """Multipliers of the rows as they came, of those of unit rows in units of 2^exponent."""
        return jnp.ldexp(multipliers / self.norms, exponent - self.exponents)


def read_channels(leaves: Sequence[Any]) -> tuple[Leaves, Any, Rows, Any]:
    """g scaled to a length of about 1, the exponent of its unit, the rows below it, and whether all are finite.

    Zeros stand for all of it where a number is not finite.
    """
    wide = jnp.promote_types(jnp.result_type(float), jnp.result_type(*leaves))
    largest = jnp.stack([jnp.abs(leaf.astype(wide)).max(axis=1, initial=0.0) for leaf in leaves]).max(axis=0)
    is_finite = jnp.isfinite(largest).all()
    exponents = jnp.where(is_finite, jnp.frexp(jnp.where(is_finite, largest, 0.0))[1], 0)
    scaled = [_scale(jnp.where(is_finite, leaf, 0).astype(wide), -exponents[:, None]) for leaf in leaves]
    K = sum(_multiply(leaf, leaf.T) for leaf in scaled)
    moves = jnp.diagonal(K) > 0.0
    norms = jnp.sqrt(jnp.where(moves, jnp.diagonal(K), 1.0))
    unit = jnp.where(moves & moves[:, None], K / norms / norms[:, None], 0.0) + jnp.diag(jnp.where(moves, 0.0, 1.0))
    rows = Rows([leaf[1:] for leaf in scaled], norms[1:], exponents[1:], moves[1:], unit[1:, 1:])
    return [leaf[0] for leaf in scaled], exponents[0], rows, is_finite


def add(x: Leaves, y: Leaves) -> Leaves:
    """x + y."""
    return [a + b for a, b in zip(x, y, strict=True)]


def rescale(x: Leaves, exponent: Any) -> Leaves:
    """2^exponent x, exactly."""
    return [_scale(leaf, exponent) for leaf in x]


def choose(condition: Any, x: Leaves, y: Leaves) -> Leaves:
    """x or y."""
    return [jnp.where(condition, a, b) for a, b in zip(x, y, strict=True)]


def length(d: Leaves) -> Any:
    """‖d‖."""
    return jnp.sqrt(sum(jnp.vdot(leaf, leaf, precision=lax.Precision.HIGHEST) for leaf in d))


def _scale(vector: Any, exponent: Any) -> Any:
    """2^exponent times it, in two products, since 2^exponent may be no number; `ldexp` of all entries takes longer."""
    half, one = exponent // 2, jnp.ones((), vector.dtype)
    return vector * jnp.ldexp(one, half) * jnp.ldexp(one, exponent - half)


def _multiply(a: Any, b: Any) -> Any:
    """Never in the shorter floats that a device may take for products."""
    return jnp.matmul(a, b, precision=lax.Precision.HIGHEST)
