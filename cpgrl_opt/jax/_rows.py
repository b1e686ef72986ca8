"""Rows on the device, as they came: products and combinations with the leaves of the parameters' tree, in unit rows.

Each number is scaled by a power of two as it is read, so that lengths of 1e±100 neither over- nor underflow inside, and
no copy is made. Products are of the widest float that there is: float64 where JAX has it enabled, else float32.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from . import _sums

Leaves = list[Any]  # a vector, as the parameters' leaves are


class Vector(NamedTuple):
    """d, Ĵd and ‖d‖."""

    leaves: Leaves
    along: Any
    length: Any


class Rows(NamedTuple):
    """ĝ = g/2^exponent, Ĵᵢ = rowᵢ/‖rowᵢ‖, ‖rowᵢ‖ = normsᵢ · 2^exponentsᵢ, and K̂ = ĴĴᵀ, of leaves (1 + m, …), g first.

    scales: ±2^−exponents, of all 1 + m; the sign is that in which a channel counts. A row that is 0 is not `moves`, has
    norm 1, and 1 on the diagonal of K̂. along: Ĵĝ; length: ‖ĝ‖.
    """

    leaves: Leaves
    scales: Any
    exponent: Any
    norms: Any
    exponents: Any
    moves: Any
    gramian: Any
    along: Any
    length: Any

    def combine(self, part: Any, weights: Any, start: Leaves | None = None) -> Leaves:
        """start + part · ĝ + Ĵᵀweights."""
        weights = jnp.concatenate([jnp.asarray(part, self.norms.dtype)[None], weights / self.norms])
        starts = self.zero() if start is None else start
        return [_sums.combine(leaf, self.scales, weights, each) for leaf, each in zip(self.leaves, starts, strict=True)]

    def look(self, d: Leaves) -> Vector:
        """d with its products."""
        sums = sum(_sums.products(leaf, self.scales, each) for leaf, each in zip(self.leaves, d, strict=True))
        return Vector(d, sums[1:-1] / self.norms, jnp.sqrt(sums[-1]))

    def products(self, d: Leaves) -> Any:
        """Ĵd, by what JAX can transpose."""
        sums = sum(
            jnp.tensordot(leaf[1:].astype(part.dtype), part, part.ndim, precision=lax.Precision.HIGHEST)
            for leaf, part in zip(self.leaves, d, strict=True)
        )
        return sums * self.scales[1:] / self.norms

    def zero(self) -> Leaves:
        """0, a vector."""
        return [jnp.zeros(leaf.shape[1:], self.norms.dtype) for leaf in self.leaves]

    def per_length(self, values: Any, exponent: Any) -> Any:
        """Bounds bᵢ/‖Jᵢ‖ in units of 2^exponent."""
        return jnp.ldexp(values.astype(self.norms.dtype), -self.exponents - exponent) / self.norms

    def original(self, multipliers: Any, exponent: Any) -> Any:
        """Multipliers of the rows as they came, of those of unit rows in units of 2^exponent."""
        return jnp.ldexp(multipliers / self.norms, exponent - self.exponents)

    def lengthen(self, along: Any, exponent: Any) -> Any:
        """J d, of Ĵd in units of 2^exponent."""
        return jnp.ldexp(along * self.norms, exponent + self.exponents)


def read_channels(leaves: Sequence[Any], signs: tuple[float, float]) -> tuple[Rows, Any]:
    """The rows, and whether all numbers are finite. signs: of g and of the rows.

    One reading of long leaves tells all where lengths are ordinary; else another looks for the largest numbers first.
    """
    wide = jnp.promote_types(jnp.result_type(float), jnp.result_type(*leaves))
    one = jnp.ones(leaves[0].shape[0], wide)

    def scale() -> tuple[Any, Any, Any]:
        largest = jnp.stack([_sums.largest(leaf, wide) for leaf in leaves]).max(axis=0)
        is_finite = jnp.isfinite(largest).all()
        exponents = jnp.where(is_finite, jnp.frexp(jnp.where(is_finite, largest, 0.0))[1], 0)
        limit = jnp.finfo(wide).maxexp - 8  # the smallest float is 1 only with a scale that is none
        exponents = jnp.clip(exponents, -limit, limit)
        return sum(_sums.gramian(leaf, jnp.ldexp(one, -exponents), wide) for leaf in leaves), exponents, is_finite

    if max(leaf.size for leaf in leaves) < _sums.LONG:
        K, exponents, is_finite = scale()
    else:
        K = sum(_sums.gramian(leaf, one, wide) for leaf in leaves)
        least = float(jnp.finfo(wide).tiny) ** 0.75  # squares of float32 numbers in float64 are far from it
        is_ordinary = ((jnp.diagonal(K) > least) & (jnp.diagonal(K) < 1.0 / least)).all()

        def read() -> tuple[Any, Any, Any]:
            halves = jnp.frexp(jnp.diagonal(K))[1] // 2
            return jnp.ldexp(jnp.ldexp(K, -halves), -halves[:, None]), halves, jnp.asarray(True)

        K, exponents, is_finite = lax.cond(is_ordinary, read, scale)
    K = jnp.where(is_finite, K, 0.0)
    moves = jnp.diagonal(K) > 0.0
    norms = jnp.sqrt(jnp.where(moves, jnp.diagonal(K), 1.0))
    unit = jnp.where(moves & moves[:, None], K / norms / norms[:, None], 0.0) + jnp.diag(jnp.where(moves, 0.0, 1.0))
    turn = jnp.where(jnp.arange(len(one)) == 0, signs[0], signs[1]).astype(wide)
    along, length = jnp.where(moves[0], norms[0] * unit[0, 1:], 0.0), jnp.where(moves[0], norms[0], 0.0)
    rest = norms[1:], exponents[1:], moves[1:], unit[1:, 1:], signs[0] * signs[1] * along, length
    return Rows(list(leaves), turn * jnp.ldexp(one, -exponents), exponents[0], *rest), is_finite


def rescale(x: Leaves, exponent: Any) -> Leaves:
    """2^exponent x, exactly."""
    return [_scale(leaf, exponent) for leaf in x]


def _scale(vector: Any, exponent: Any) -> Any:
    """2^exponent times it, in two products, since 2^exponent may be no number; `ldexp` of all entries takes longer."""
    half, one = exponent // 2, jnp.ones((), vector.dtype)
    return vector * jnp.ldexp(one, half) * jnp.ldexp(one, exponent - half)
