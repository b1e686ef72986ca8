"""NumPy arrays of float64: one of g and one of the rows of J, in any order of storage."""

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

from ..arrays import Float, Jacobian, Multipliers, Vector
from ..compensated import Pair
from ..validation import is_finite
from .interface import Certificate

# Below this a solve on the rows themselves is faster than Python's part of a reduction, 0.1 ms, or nearly so. With
# `active-set` the two meet at n = 30 000 with one constraint, 7000 with five, 1200 with fifteen and 500 with fifty.
LEAST_PRODUCTS = 1_000_000

_FLOAT64 = np.dtype(np.float64)


def is_long(m: int, n: int) -> bool:
    """Whether a problem is reduced to its vectors' span first: n (1 + m) max(10, 1 + m) ≥ 10⁶ and n > 4 (1 + m)."""
    return n * (1 + m) * max(10, 1 + m) >= LEAST_PRODUCTS and n > 4 * (1 + m)


@cache
def _blocks() -> Any:
    """The module of compiled passes; imports numba."""
    from . import _blocks as compiled

    return compiled


@dataclass(frozen=True, eq=False)
class ArrayVectors:
    """g (n,) and J, one array (m, n) or its rows apart."""

    gradient: Vector
    jacobian: Jacobian | tuple[Vector, ...]

    def __getstate__(self) -> dict[str, Any]:
        """Without what was found: the arrays of a copy lie elsewhere."""
        return {"gradient": self.gradient, "jacobian": self.jacobian}

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n), by the rows."""
        if isinstance(self.jacobian, tuple):
            return len(self.jacobian), len(self.jacobian[0])
        return self.jacobian.shape[0], self.jacobian.shape[1]

    def lengths(self) -> Float[np.ndarray, "channels"]:
        """Of g and of each row; over- or underflows with their squares."""
        return np.asarray(np.sqrt(self._gramian.diagonal()))

    def gramian(self) -> Float[np.ndarray, "channels channels"]:
        """K, each entry to about √n eps ‖vᵢ‖‖vⱼ‖; found once."""
        return self._gramian

    def are_finite(self) -> bool:
        """No NaN and no infinity: seen in K, unless squares overflow."""
        return math.isfinite(self._gramian.trace()) or all(map(is_finite, (self.gradient, *self.jacobian)))

    @cached_property
    def _gramian(self) -> np.ndarray:
        K = self._square()
        _blocks().gramian(self._where, len(self.gradient), K)
        return K

    def gramian_in_pairs(self) -> Pair:
        """K, each entry to about 2⁻¹⁰⁰ ‖vᵢ‖‖vⱼ‖."""
        K = Pair(self._square(), self._square())
        _blocks().gramian_in_pairs(self._where, len(self.gradient), K.hi, K.lo)
        return K

    def is_zero(self, index: int) -> bool:
        """In one pass over that vector."""
        return not (self.gradient if index == 0 else self.jacobian[index - 1]).any()

    def combine(self, weights: Pair, multipliers: Multipliers, kappa: float = 1.0) -> tuple[Vector, Certificate]:
        """d of float64, in one pass with its certificate."""
        scale = kappa or 1.0
        forces = np.append(1.0, multipliers) / scale
        d, sums = self._combine(weights.hi, weights.lo, forces, bool(weights.lo.any()))
        return d, self._certificate(sums, multipliers, kappa)

    def combine_usually(self, weights: Float[np.ndarray, "channels"]) -> tuple[Vector, Float[np.ndarray, "k"]]:
        """d = Vᵀ(1, μ) in one pass, and r·r, J d, d·d."""
        return self._combine(weights, np.zeros(len(weights)), weights, in_pairs=False)

    def _combine(self, weights: Any, more: Any, forces: Any, in_pairs: bool) -> tuple[Any, Any]:
        d, sums = np.empty(self.gradient.shape), np.empty(1 + len(forces))
        _blocks().combine(self._where, len(d), weights, more, forces, in_pairs, d, sums)
        return d, sums

    def certificate(self, direction: Vector, multipliers: Multipliers, kappa: float = 1.0) -> Certificate:
        """In one pass; in two where κ = 0."""
        d, forces = np.ascontiguousarray(direction), np.append(1.0, multipliers) / (kappa or 1.0)
        sums = np.empty(1 + len(forces))
        _blocks().measure(self._where, len(d), d, forces, sums)
        return self._certificate(sums, multipliers, kappa)

    def _certificate(self, sums: np.ndarray, multipliers: Multipliers, kappa: float) -> Certificate:
        """Of κ times the rest d − (g + Jᵀμ)/κ; where κ = 0 the rest is that of d = 0."""
        if kappa == 0.0:
            rest = self.certificate(np.zeros(self.gradient.shape), multipliers).rest
        else:
            rest = abs(kappa) * math.sqrt(sums[0])
        return Certificate(rest, sums[1:-1], math.sqrt(sums[-1]))

    def _square(self) -> np.ndarray:
        count = 1 + len(self.jacobian)
        return np.empty((count, count))

    @cached_property
    def _where(self) -> np.ndarray:
        """Address of each vector, and bytes from one of its numbers to the next."""
        g, J = self.gradient, self.jacobian
        parts = (g, *J) if isinstance(J, tuple) else (g, J)
        for array in parts:  # what lies at an address nobody checks again
            if array.dtype != _FLOAT64 or array.shape[-1] != len(g):
                raise ValueError(f"vectors should be of {len(g)} float64; found {array.dtype}, shape {array.shape}")
        places = [(array.__array_interface__["data"][0], array.strides[-1]) for array in parts]
        if not isinstance(J, tuple):
            (start, step), to_next = places.pop(), J.strides[0]
            places += [(start + i * to_next, step) for i in range(len(J))]
        return np.array(places, np.int64)
