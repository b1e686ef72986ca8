"""Arrays in this process's memory: of g and of the rows of J, in any order of storage, in one leaf or many."""

import math
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from ..arrays import Float, Jacobian, Vector
from ..compensated import Pair
from ..validation import is_finite, require_finite
from ._bfloat16 import narrow, widen
from .interface import Sums, Vectors

# Below this a solve on the rows themselves is faster than Python's part of a reduction, 0.1 ms, or nearly so. With
# `active-set` the two meet at n = 30 000 with one constraint, 7000 with five, 1200 with fifteen and 500 with fifty.
LEAST_PRODUCTS = 1_000_000

BFLOAT16 = np.dtype(np.uint16)  # its bits: NumPy knows no such numbers, see `_bfloat16`
DTYPES = np.dtype(np.float64), np.dtype(np.float32)
_NO_ROWS = {dtype: np.empty((0, 0), dtype) for dtype in (*DTYPES, BFLOAT16)}
Leaf = tuple[Any, Any]
REPRESENTABLE = 1e76  # of d·d: up to here no entry of d leaves float32 or bfloat16, which end at 3e38


def is_long(m: int, n: int) -> bool:
    """Whether a problem is reduced to its vectors' span first: n (1 + m) max(10, 1 + m) ≥ 10⁶ and n > 4 (1 + m)."""
    return n * (1 + m) * max(10, 1 + m) >= LEAST_PRODUCTS and n > 4 * (1 + m)


@cache
def _blocks() -> Any:
    """The module of compiled passes; imports numba."""
    from . import _blocks as compiled

    return compiled


class LeafVectors(Vectors):
    """Vectors that lie in this process's memory, in one leaf or many: g's parts and those of the rows of J."""

    has_rows = True

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
        return np.concatenate([self.host(g) for g, _ in self.leaves], dtype=np.float64)

    def whole_jacobian(self) -> Jacobian:
        """J, one array of float64."""
        m, n = self.shape
        whole, start = np.empty((m, n)), 0
        for g, J in self.leaves:
            for i in range(m):
                whole[i, start : start + len(g)] = self.host(J[i])
            start += len(g)
        return whole

    def row_of(self, direction: Any, name: str = "direction.value") -> Vector:
        """d as one array of float64."""
        if type(direction) is np.ndarray and direction.dtype == np.float64 and direction.shape == (self.shape[1],):
            return direction
        return np.concatenate([*map(self.host, self.taken_apart(direction, name))], dtype=np.float64)

    def from_row(self, row: Vector) -> Any:
        """d of the caller's kind, rounded to its leaves' dtypes."""
        with np.errstate(over="ignore"):
            pairs = zip(self.split(row), self.leaves, strict=True)
            return self.rebuilt([self.rounded(part, g) for part, (g, _) in pairs])

    def split(self, row: Vector) -> list[np.ndarray]:
        """By leaves."""
        ends = accumulate((len(g) for g, _ in self.leaves), initial=0)
        return [row[start:end] for start, end in pairwise(ends)]

    def host(self, part: Any) -> np.ndarray:
        """A part in numbers that NumPy knows."""
        return np.asarray(widen(part)) if part.dtype == BFLOAT16 else part

    def rounded(self, part: np.ndarray, like: Any) -> Any:
        """A part of float64 in the dtype of another."""
        return narrow(part) if like.dtype == BFLOAT16 else part.astype(like.dtype)

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n), by the rows."""
        return len(self.leaves[0][1]), sum(len(g) for g, _ in self.leaves)

    def are_finite(self) -> bool:
        """No NaN and no infinity: seen in K, unless squares overflow."""
        if is_long(*self.shape) and math.isfinite(sum(self.gramian().diagonal().tolist())):
            return True
        return all(is_finite(self.host(part)) for leaf in self.leaves for part in _arrays(*leaf))

    def require_finite(self) -> None:
        """ValueError that names the leaf."""
        if not self.shape[1]:
            raise ValueError("gradient should have at least one component; found none")
        if not self.are_finite():
            for index, (g, J) in enumerate(self.leaves):
                where = f", leaf {index}" if len(self.leaves) > 1 else ""
                require_finite(f"gradient{where}", self.host(g))
                for row in J:
                    require_finite(f"jacobian{where}", self.host(row))

    def is_representable(self, direction: Any) -> bool:
        """Seen in each leaf."""
        return all(is_finite(self.host(part)) for part in self.taken_apart(direction))

    def is_zero(self, index: int) -> bool:
        """In one pass over that vector."""
        return not any(self.host(g if index == 0 else J[index - 1]).any() for g, J in self.leaves)

    def find_gramian(self) -> Float[np.ndarray, "channels channels"]:
        """In one pass."""
        K = self._square()
        for dtype, _, where in self._where:
            _blocks().gramian[dtype].machine_code(*where, K)
        return K

    def gramian_in_pairs(self) -> Pair:
        """In one pass."""
        K = Pair(self._square(), self._square())
        for dtype, _, where in self._where:
            _blocks().gramian_in_pairs[dtype].machine_code(*where, *K)
        return K

    def form(self, weights: Pair, forces: Float[np.ndarray, "channels"]) -> tuple[Any, Sums]:
        """In one pass; d's leaves of one dtype lie in one piece, which the system hands out sooner than many."""
        parts, sums = dict[int, np.ndarray](), np.zeros(1 + len(forces))
        for dtype, leaves, where in self._where:
            ends = [*accumulate((len(self.leaves[k][0]) for k in leaves), initial=0)]
            whole = np.empty(ends[-1], dtype)
            parts |= {k: whole[start:end] for k, (start, end) in zip(leaves, pairwise(ends), strict=True)}
            _blocks().combine[dtype].machine_code(*where, *weights, forces, _places(parts, leaves), sums)
        return self.rebuilt([parts[k] for k in range(len(parts))]), sums

    def measure(self, direction: Any, forces: Float[np.ndarray, "channels"]) -> Sums:
        """In one pass."""
        parts, sums = self.taken_apart(direction), np.zeros(1 + len(forces))
        for dtype, leaves, where in self._where:
            _blocks().measure[dtype].machine_code(*where, _places(parts, leaves), forces, sums)
        return sums

    def _square(self) -> np.ndarray:
        count = 1 + len(self.leaves[0][1])
        return np.zeros((count, count))

    @cached_property
    def _where(self) -> list[tuple[Any, list[int], tuple[np.ndarray, np.ndarray]]]:
        """Of each dtype its leaves and, for the passes, an empty array of it and where these leaves lie."""
        alike: dict[Any, list[int]] = {}
        for k, (g, _) in enumerate(self.leaves):
            alike.setdefault(g.dtype, []).append(k)
        return [(dtype, of, (np.empty(0, dtype), _locate([self.leaves[k] for k in of]))) for dtype, of in alike.items()]


def _arrays(g: np.ndarray, J: np.ndarray | tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    return (g, *J) if isinstance(J, tuple) else (g, J)


def _locate(leaves: list[Leaf]) -> np.ndarray:
    """(leaves, 1 + m, 4): of each vector its address, bytes from number to number, numbers, and bytes of one."""
    where, dtype = np.empty((len(leaves), 1 + len(leaves[0][1]), 4), np.int64), leaves[0][0].dtype
    if dtype not in _NO_ROWS:
        raise ValueError(f"vectors should be of float64, float32 or bfloat16; found {dtype}")
    locate, no_rows = _blocks().locate[dtype].machine_code, _NO_ROWS[dtype]
    for places, (g, J) in zip(where, leaves, strict=True):
        count = len(g)
        for array in _arrays(g, J):
            if array.dtype != dtype or array.shape[-1] != count:  # what lies at an address nobody checks again
                raise ValueError(
                    f"vectors should be of {count} numbers of {dtype}; found {array.dtype}, shape {array.shape}"
                )
        if isinstance(J, tuple):
            for i, array in enumerate((g, *J)):
                locate(array, no_rows, places[i:])
        else:
            locate(g, J, places)
    return where


def _places(parts: Any, leaves: list[int]) -> np.ndarray:
    """(leaves, 4): the same of arrays whose numbers lie side by side."""
    where = np.empty((len(leaves), 4), np.int64)
    for i, k in enumerate(leaves):
        dtype = parts[k].dtype
        _blocks().locate[dtype].machine_code(parts[k], _NO_ROWS[dtype], where[i:])
    return where


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
