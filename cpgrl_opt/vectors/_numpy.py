"""Arrays in this process's memory: of g and of the rows of J, in any order of storage, in one leaf or many."""

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

from ..arrays import Float, Jacobian, Multipliers, Vector
from ..compensated import Pair
from ..validation import is_finite
from ._bfloat16 import narrow, widen
from .interface import Certificate

# Below this a solve on the rows themselves is faster than Python's part of a reduction, 0.1 ms, or nearly so. With
# `active-set` the two meet at n = 30 000 with one constraint, 7000 with five, 1200 with fifteen and 500 with fifty.
LEAST_PRODUCTS = 1_000_000

BFLOAT16 = np.dtype(np.uint16)  # its bits: NumPy knows no such numbers, see `_bfloat16`
DTYPES = np.dtype(np.float64), np.dtype(np.float32)
Leaf = tuple[Any, Any]


def is_long(m: int, n: int) -> bool:
    """Whether a problem is reduced to its vectors' span first: n (1 + m) max(10, 1 + m) ≥ 10⁶ and n > 4 (1 + m)."""
    return n * (1 + m) * max(10, 1 + m) >= LEAST_PRODUCTS and n > 4 * (1 + m)


@cache
def _blocks() -> Any:
    """The module of compiled passes; imports numba."""
    from . import _blocks as compiled

    return compiled


class LeafVectors:
    """Vectors that lie in this process's memory, in one leaf or many: g's parts and those of the rows of J."""

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        """(g's part (k,), J's part (m, k) or its rows apart) of each leaf, of one of DTYPES or BFLOAT16."""
        raise NotImplementedError

    def rebuilt(self, parts: list[np.ndarray]) -> Any:
        """The caller's kind of vector, of one array (k,) a leaf."""
        raise NotImplementedError

    def taken_apart(self, direction: Any, name: str = "direction.value") -> list[np.ndarray]:
        """The other way, contiguous; ValueError about `name` for what does not fit."""
        raise NotImplementedError

    def whole_gradient(self) -> Vector:
        """g, one array of float64."""
        return np.concatenate([_widened(g) for g, _ in self.leaves], dtype=np.float64)

    def whole_jacobian(self) -> Jacobian:
        """J, one array of float64."""
        m, n = self.shape
        whole, start = np.empty((m, n)), 0
        for g, J in self.leaves:
            for i in range(m):
                whole[i, start : start + len(g)] = _widened(J[i])
            start += len(g)
        return whole

    def row_of(self, direction: Any, name: str = "direction.value") -> Vector:
        """d as one array of float64."""
        return np.concatenate([*map(_widened, self.taken_apart(direction, name))], dtype=np.float64)

    def from_row(self, row: Vector) -> Any:
        """d of the caller's kind, rounded to its leaves' dtypes."""
        ends = np.cumsum([len(g) for g, _ in self.leaves])[:-1]
        pairs = zip(np.split(row, ends), self.leaves, strict=True)
        with np.errstate(over="ignore"):
            parts = [narrow(part) if g.dtype == BFLOAT16 else part.astype(g.dtype) for part, (g, _) in pairs]
        return self.rebuilt(parts)

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n), by the rows."""
        return len(self.leaves[0][1]), sum(len(g) for g, _ in self.leaves)

    def lengths(self) -> Float[np.ndarray, "channels"]:
        """Of g and of each row; over- or underflows with their squares."""
        return np.asarray(np.sqrt(self._gramian.diagonal()))

    def gramian(self) -> Float[np.ndarray, "channels channels"]:
        """K, each entry to about √n eps ‖vᵢ‖‖vⱼ‖; found once."""
        return self._gramian

    def are_finite(self) -> bool:
        """No NaN and no infinity: seen in K, unless squares overflow."""
        if math.isfinite(self._gramian.trace()):
            return True
        return all(is_finite(_widened(part)) for g, J in self.leaves for part in (g, *J))

    @cached_property
    def _gramian(self) -> np.ndarray:
        K = self._square()
        for _, where in self._where:
            _blocks().gramian(*where, K)
        return K

    def gramian_in_pairs(self) -> Pair:
        """K, each entry to about 2⁻¹⁰⁰ ‖vᵢ‖‖vⱼ‖."""
        K = Pair(self._square(), self._square())
        for _, where in self._where:
            _blocks().gramian_in_pairs(*where, K.hi, K.lo)
        return K

    def is_zero(self, index: int) -> bool:
        """In one pass over that vector."""
        return not any(_widened(g if index == 0 else J[index - 1]).any() for g, J in self.leaves)

    def combine(self, weights: Pair, multipliers: Multipliers, kappa: float = 1.0) -> tuple[Any, Certificate]:
        """d, in one pass with its certificate, which is of d before it is rounded to a leaf's dtype."""
        forces = np.append(1.0, multipliers) / (kappa or 1.0)
        d, sums = self._combine(weights.hi, weights.lo, forces, bool(weights.lo.any()))
        return d, self._certificate(sums, multipliers, kappa)

    def combine_usually(self, weights: Float[np.ndarray, "channels"]) -> tuple[Any, Float[np.ndarray, "k"]]:
        """d = Vᵀ(1, μ) in one pass, and r·r, J d, d·d."""
        return self._combine(weights, np.zeros(len(weights)), weights, in_pairs=False)

    def _combine(self, weights: Any, more: Any, forces: Any, in_pairs: bool) -> tuple[Any, Any]:
        parts, sums = [np.empty(len(g), g.dtype) for g, _ in self.leaves], np.zeros(1 + len(forces))
        for leaves, where in self._where:
            _blocks().combine(*where, weights, more, forces, in_pairs, _places(parts, leaves), sums)
        return self.rebuilt(parts), sums

    def certificate(self, direction: Any, multipliers: Multipliers, kappa: float = 1.0) -> Certificate:
        """In one pass; in two where κ = 0."""
        return self._measure(self.taken_apart(direction), multipliers, kappa)

    def _measure(self, parts: list[np.ndarray], multipliers: Multipliers, kappa: float) -> Certificate:
        forces = np.append(1.0, multipliers) / (kappa or 1.0)
        sums = np.zeros(1 + len(forces))
        for leaves, where in self._where:
            _blocks().measure(*where, _places(parts, leaves), forces, sums)
        return self._certificate(sums, multipliers, kappa)

    def _certificate(self, sums: np.ndarray, multipliers: Multipliers, kappa: float) -> Certificate:
        """Of κ times the rest d − (g + Jᵀμ)/κ; where κ = 0 the rest is that of d = 0."""
        if kappa == 0.0:
            nothing = [np.zeros(len(g)) for g, _ in self.leaves]
            rest = self._measure(nothing, multipliers, 1.0).rest
        else:
            rest = abs(kappa) * math.sqrt(sums[0])
        return Certificate(rest, sums[1:-1], math.sqrt(sums[-1]))

    def _square(self) -> np.ndarray:
        count = 1 + len(self.leaves[0][1])
        return np.zeros((count, count))

    @cached_property
    def _where(self) -> list[tuple[list[int], tuple[np.ndarray, np.ndarray]]]:
        """Of each dtype its leaves and, for the passes, where these lie and how many numbers each has."""
        sizes = [g.itemsize for g, _ in self.leaves]
        alike = [[k for k, each in enumerate(sizes) if each == size] for size in dict.fromkeys(sizes)]
        return [(leaves, self._where_are(leaves)) for leaves in alike]

    def _where_are(self, leaves: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """Address of each vector in each leaf, bytes from one of its numbers to the next and of one; and numbers."""
        counts = np.array([len(self.leaves[k][0]) for k in leaves], np.int64)
        return np.array([_places_of(*self.leaves[k]) for k in leaves], np.int64), counts


def _widened(part: np.ndarray) -> np.ndarray:
    """Numbers that NumPy knows."""
    return np.asarray(widen(part)) if part.dtype == BFLOAT16 else part


def _places_of(g: np.ndarray, J: np.ndarray | tuple[np.ndarray, ...]) -> list[tuple[int, int, int]]:
    parts = (g, *J) if isinstance(J, tuple) else (g, J)
    for array in parts:  # what lies at an address nobody checks again
        if array.dtype != g.dtype or g.dtype not in (*DTYPES, BFLOAT16) or array.shape[-1] != len(g):
            raise ValueError(
                f"vectors should be of {len(g)} numbers of one dtype, float64, float32 or bfloat16; "
                f"found {array.dtype} beside {g.dtype}, shape {array.shape}"
            )
    places = [(array.__array_interface__["data"][0], array.strides[-1], array.itemsize) for array in parts]
    if not isinstance(J, tuple):
        (start, step, size), to_next = places.pop(), J.strides[0]
        places += [(start + i * to_next, step, size) for i in range(len(J))]
    return places


def _places(parts: list[np.ndarray], leaves: list[int]) -> np.ndarray:
    """Of arrays whose numbers lie side by side."""
    chosen = [parts[k] for k in leaves]
    return np.array([(each.__array_interface__["data"][0], each.itemsize, each.itemsize) for each in chosen], np.int64)


@dataclass(frozen=True, eq=False)
class ArrayVectors(LeafVectors):
    """g (n,) and J, one array (m, n) or its rows apart."""

    gradient: Vector
    jacobian: Jacobian | tuple[Vector, ...]

    def __getstate__(self) -> dict[str, Any]:
        """Without what was found: the arrays of a copy lie elsewhere."""
        return {"gradient": self.gradient, "jacobian": self.jacobian}

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        """One."""
        return ((self.gradient, self.jacobian),)

    def whole_gradient(self) -> Vector:
        """It is g."""
        return self.gradient

    def from_row(self, row: Vector) -> Any:
        """It is d."""
        return row

    def rebuilt(self, parts: list[np.ndarray]) -> Any:
        """It is d."""
        return parts[0]

    def taken_apart(self, direction: Any, name: str = "direction.value") -> list[np.ndarray]:  # noqa: ARG002
        """Of one leaf."""
        return [np.ascontiguousarray(direction)]
