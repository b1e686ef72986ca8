"""NumPy arrays of float64: one of g and one of the rows of J, in any order of storage."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

from ..arrays import Float, Jacobian, Multipliers, Vector
from ..compensated import Pair
from ..validation import is_finite
from .interface import Certificate

# Numbers copied at a time where rows are not contiguous or lie apart: 1.6 MB, which the passes find again in a cache;
# with a quarter of it Python's loop over rows apart counts. Rows of the copy begin an odd number of cache lines apart:
# with a power of two all compete for the same few lines of the first-level cache, and 31 rows take four times as long.
_CHUNK, _LINE, _FEWEST = 200_000, 8, 17

# Below this the rows themselves are solved on faster than Python's part of a reduction takes, 0.2 ms. The two meet at
# n = 20 000 with one constraint and with five, at 3000 with fifteen, at 1000 with fifty.
LEAST_PRODUCTS = 1_000_000


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
        return bool(np.isfinite(self._gramian.diagonal()).all()) or all(map(is_finite, (self.gradient, *self.jacobian)))

    @cached_property
    def _gramian(self) -> np.ndarray:
        K = self._square()
        for gradient, jacobian, _ in self._chunks():
            _blocks().gramian(gradient, jacobian, K)
        return _mirrored(K)

    def gramian_in_pairs(self) -> Pair:
        """K, each entry to about 2⁻¹⁰⁰ ‖vᵢ‖‖vⱼ‖."""
        total = Pair(self._square(), self._square())
        for gradient, jacobian, _ in self._chunks():
            part = Pair(self._square(), self._square())
            _blocks().gramian_in_pairs(gradient, jacobian, part.hi, part.lo)
            total = total.plus(part)
        return Pair(_mirrored(total.hi), _mirrored(total.lo))

    def is_zero(self, index: int) -> bool:
        """In one pass over that vector."""
        return not (self.gradient if index == 0 else self.jacobian[index - 1]).any()

    def combine(self, weights: Pair, multipliers: Multipliers) -> tuple[Vector, Certificate]:
        """d of float64, in one pass with its certificate."""
        d, sums = self._combine(weights.hi, weights.lo, np.append(1.0, multipliers), bool(weights.lo.any()))
        return d, _certificate(sums)

    def combine_usually(self, weights: Float[np.ndarray, "channels"]) -> tuple[Vector, Float[np.ndarray, "k"]]:
        """d = Vᵀ(1, μ) in one pass, and r·r, J d, d·d."""
        return self._combine(weights, np.zeros(len(weights)), weights, in_pairs=False)

    def _combine(self, weights: Any, more: Any, forces: Any, in_pairs: bool) -> tuple[Any, Any]:
        d, sums = np.empty(self.gradient.shape), np.zeros(1 + len(forces))
        if not in_pairs and (columns_of_J := self._columns()) is not None:
            _blocks().combine_columns(self.gradient, columns_of_J, weights, forces, d, sums)
            return d, sums
        for gradient, jacobian, columns in self._chunks():
            _blocks().combine(gradient, jacobian, weights, more, forces, in_pairs, d[columns], sums)
        return d, sums

    def certificate(self, direction: Vector, multipliers: Multipliers) -> Certificate:
        """In one pass."""
        sums, forces = np.zeros(2 + len(multipliers)), np.append(1.0, multipliers)
        for gradient, jacobian, columns in self._chunks():
            _blocks().measure(gradient, jacobian, np.ascontiguousarray(direction[columns]), forces, sums)
        return _certificate(sums)

    def _square(self) -> np.ndarray:
        return np.zeros((1 + len(self.jacobian), 1 + len(self.jacobian)))

    def _columns(self) -> Float[np.ndarray, "n m"] | None:
        """Jᵀ where J lies column by column."""
        g, J = self.gradient, self.jacobian
        if isinstance(J, tuple) or J.flags.c_contiguous or not (J.T.flags.c_contiguous and g.flags.c_contiguous):
            return None
        return J.T

    def _chunks(self) -> Iterator[tuple[Vector, Jacobian, slice]]:
        """(g, J) as the compiled passes take them: as they are if they can be, else copies of some columns."""
        g, J, n = self.gradient, self.jacobian, len(self.gradient)
        if not isinstance(J, tuple) and g.flags.c_contiguous and J.flags.c_contiguous:
            yield g, J, slice(0, n)
            return
        lines = max(_CHUNK // (1 + len(J)) // _LINE, _FEWEST)  # of a row at a time
        size = (lines - 1 + lines % 2) * _LINE
        buffer = np.empty((len(J), min(size, n)))
        for start in range(0, n, size):
            columns, part = slice(start, start + size), buffer if start + size <= n else np.empty((len(J), n - start))
            if isinstance(J, tuple):
                for to, row in zip(part, J, strict=True):
                    to[:] = row[columns]
            else:
                _blocks().pack(J[:, columns], part)
            yield np.ascontiguousarray(g[columns]), part, columns


def _certificate(sums: np.ndarray) -> Certificate:
    rest, length = np.sqrt(sums[[0, -1]]).tolist()
    return Certificate(rest, sums[1:-1], length)


def _mirrored(lower: np.ndarray) -> np.ndarray:
    """A symmetric matrix of its lower triangle, 0 above."""
    full: np.ndarray = lower + lower.T
    np.fill_diagonal(full, lower.diagonal())
    return full
