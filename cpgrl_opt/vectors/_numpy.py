"""Arrays in this process's memory: of g and of the rows of J, in any order of storage, in one leaf or many."""

import math
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
_LIKE = {dtype: np.empty(0, dtype) for dtype in (*DTYPES, BFLOAT16)}
_NO_WEIGHTS, _NO_PLACES = np.empty(0), np.empty((0, 4), np.int64)
Leaf = tuple[Any, Any]
Group = tuple[Any, list[tuple[Any, ...]], np.ndarray]  # of `LeafVectors._groups`
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

    def __reduce__(self) -> tuple[Any, ...]:
        """Without what was found: the arrays of a copy lie elsewhere."""
        return type(self), (self.gradient, self.jacobian)

    @property
    def leaves(self) -> tuple[Leaf, ...]:
        """(g's part (k,), J's part (m, k) or its rows apart) of each leaf, of one of DTYPES or BFLOAT16."""
        raise NotImplementedError

    def rebuild(self, parts: list[np.ndarray]) -> Any:
        """The caller's kind of vector, of one array (k,) a leaf."""
        raise NotImplementedError

    def take_apart(self, direction: Any, name: str = "direction.value") -> list[np.ndarray]:
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
        return np.concatenate([*map(self.host, self.take_apart(direction, name))], dtype=np.float64)

    def from_row(self, row: Vector) -> Any:
        """d of the caller's kind, rounded to its leaves' dtypes."""
        with np.errstate(over="ignore"):
            pairs = zip(self.split(row), self.leaves, strict=True)
            return self.rebuild([self.rounded(part, g) for part, (g, _) in pairs])

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
        return all(
            is_finite(self.host(part)) for g, J in self.leaves for part in ((g, *J) if isinstance(J, tuple) else (g, J))
        )

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
        return all(is_finite(self.host(part)) for part in self.take_apart(direction))

    def is_zero(self, index: int) -> bool:
        """In one pass over that vector."""
        return not any(self.host(g if index == 0 else J[index - 1]).any() for g, J in self.leaves)

    def find_gramian(self) -> Float[np.ndarray, "channels channels"]:
        """In one pass."""
        groups = self._groups
        K = np.zeros((groups[0][2].shape[1],) * 2)
        for dtype, _, where in groups:
            _blocks().gramian[dtype].machine_code(_LIKE[dtype], where, K)
        return K

    def gramian_in_pairs(self) -> Pair:
        """In one pass."""
        K = Pair(self._square(), self._square())
        for dtype, _, where in self._groups:
            _blocks().gramian_in_pairs[dtype].machine_code(_LIKE[dtype], where, *K)
        return K

    def form(self, weights: Pair, forces: Float[np.ndarray, "channels"]) -> tuple[Any, Sums]:
        """In one pass; d's leaves of one dtype lie in one piece, which the system hands out sooner than many."""
        parts, sums = dict[int, np.ndarray](), np.zeros(1 + len(forces))
        for dtype, spans, where in self._groups:
            whole = np.empty(spans[-1][2], dtype)
            _blocks().combine[dtype].machine_code(whole, where, *weights, forces, _NO_PLACES, sums)
            for leaf, start, end in spans:
                parts[leaf] = whole[start:end]
        return self.rebuild([*map(parts.__getitem__, range(len(parts)))]), sums

    def measure(self, direction: Any, forces: Float[np.ndarray, "channels"]) -> Sums:
        """In one pass."""
        parts, sums, nothing = self.take_apart(direction), np.zeros(1 + len(forces)), (_NO_WEIGHTS, _NO_WEIGHTS)
        for dtype, spans, where in self._groups:
            places = np.empty((len(spans), 4), np.int64)
            for place, (leaf, _, _) in zip(places, spans, strict=True):
                part = parts[leaf]
                _blocks().locate[part.dtype].machine_code(part, part[None][:0], place[None])
            _blocks().combine[dtype].machine_code(_LIKE[dtype], where, *nothing, forces, places, sums)
        return sums

    def _square(self) -> np.ndarray:
        count = 1 + self.shape[0]
        return np.zeros((count, count))

    @cached_property
    def _groups(self) -> list[Group]:
        """Of each dtype its leaves with their spans in one piece of d, and for the passes where they lie."""
        groups: dict[Any, tuple[Any, ...]] = {}
        for k, (g, J) in enumerate(self.leaves):
            _, spans, where = groups.setdefault(g.dtype, (g.dtype, [], []))
            start = spans[-1][2] if spans else 0
            spans.append((k, start, start + len(g)))
            where.append(_locate(g, J))
        return [(dtype, spans, np.array(where)) for dtype, spans, where in groups.values()]


def addresses(arrays: list[np.ndarray]) -> np.ndarray:
    """Where arrays of one dtype, C-contiguous, begin."""
    blocks, count = _blocks(), len(arrays)
    flat = [array if array.ndim == 1 else array.ravel() for array in arrays]
    flat += flat[-1:] * (-count % blocks.MANY)
    found, find = np.empty(count, np.int64), blocks.find_addresses[arrays[0].dtype].machine_code
    for start in range(0, count, blocks.MANY):
        find(tuple(flat[start : start + blocks.MANY]), found[start : start + blocks.MANY])
    return found


def _locate(g: np.ndarray, J: np.ndarray | tuple[np.ndarray, ...]) -> np.ndarray:
    """(1 + m, 4): of each vector its address, bytes from number to number, numbers, and bytes of one."""
    where, dtype = np.empty((1 + len(J), 4), np.int64), g.dtype
    if dtype not in _LIKE:
        raise ValueError(f"vectors should be of float64, float32 or bfloat16; found {dtype}")
    for rows in [J] if isinstance(J, np.ndarray) else J:
        if rows.dtype != dtype or rows.shape[-1] != len(g):  # what lies at an address nobody checks again
            raise ValueError(f"vectors should be of {len(g)} numbers of {dtype}; found {rows.dtype}, {rows.shape[-1]}")
    locate = _blocks().locate[dtype].machine_code
    if isinstance(J, np.ndarray):
        locate(g, J, where)
    else:
        for k, row in enumerate((g, *J)):
            locate(row, row[None][:0], where[k:])
    return where


class ArrayVectors(LeafVectors):
    """g (n,) and J, one array (m, n) or its rows apart.

    At n = 10⁶ and one constraint Python's part is a twentieth of a direction's time: so there are few calls.
    """

    shape: tuple[int, int] = (0, 0)  # no properties, as they are of leaves
    _groups: list[Group] = []  # noqa: RUF012 - each has its own

    def __init__(self, gradient: Vector, jacobian: Jacobian | tuple[Vector, ...]) -> None:
        self.gradient, self.jacobian, self.shape = gradient, jacobian, (len(jacobian), len(gradient))
        self._groups = [(gradient.dtype, [(0, 0, len(gradient))], _locate(gradient, jacobian)[None])]

    @property
    def leaves(self) -> tuple[Leaf, ...]:
        """One."""
        return ((self.gradient, self.jacobian),)

    def require_finite(self) -> None:
        """Seen in K, but where squares overflow."""
        K = vars(self)["_gramian"] = self.find_gramian()
        if not math.isfinite(sum(K.diagonal().tolist())):
            super().require_finite()

    def combine_usually(self, weights: Float[np.ndarray, "channels"]) -> tuple[Any, Sums]:
        """In one pass."""
        [(dtype, _, where)] = self._groups
        d, sums = np.empty(self.shape[1], dtype), np.zeros(1 + len(weights))
        _blocks().combine[dtype].machine_code(d, where, weights, _NO_WEIGHTS, weights, _NO_PLACES, sums)
        return d, sums

    def whole_gradient(self) -> Vector:
        """It is g."""
        return self.gradient  # type: ignore[no-any-return]

    def from_row(self, row: Vector) -> Any:
        """It is d."""
        return row

    def rebuild(self, parts: list[np.ndarray]) -> Any:
        """It is d."""
        return parts[0]

    def take_apart(self, direction: Any, name: str = "direction.value") -> list[np.ndarray]:  # noqa: ARG002
        """Of one leaf."""
        return [np.ascontiguousarray(direction)]
