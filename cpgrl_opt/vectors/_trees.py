"""Trees of arrays: a list, tuple or dict, nested, of parameter-shaped arrays; one array is a tree of one leaf.

g has the structure of the parameters. J has it too, every leaf with the constraints as its first axis, as a Jacobian by
automatic differentiation comes; or it is a list of such trees, one a row. Leaves are NumPy's, PyTorch's or JAX's, of
float64, float32 or bfloat16. All are read where they lie, and d comes back as g came: structure, shapes, dtypes.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from . import _jax, _torch
from ._numpy import BFLOAT16, DTYPES, Group, Leaf, LeafVectors, addresses
from ._structure import NODES, leaves_of, map_leaves, names_of, structure_of

_WIDE = 8  # bytes of a float64, in either order
_FORM = attrgetter("dtype", "shape")


@dataclass(frozen=True, eq=False)
class TreeVectors(LeafVectors):
    """g and J as they were handed over."""

    gradient: Any
    jacobian: Any

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        """g's part, flat, and J's as (m, k) or as rows apart; ValueError for what does not fit."""
        own, *others = self._given
        for k, leaf in enumerate(own):
            if _is_array(leaf) and _library(leaf) != _library(own[0]):
                self._refuse("gradient", k, f"be of {_library(own[0])} as gradient is", _library(leaf))
        parts = self._flat("gradient", own, is_row=False)
        if not self._is_stacked:
            rows = [self._flat(f"jacobian[{i}]", row) for i, row in enumerate(others)]
            return tuple(zip(parts, [*zip(*rows, strict=True)] or [()] * len(parts), strict=True))
        stacked = self._flat("jacobian", others[0])
        if len(counts := {len(part) for part in stacked}) > 1:
            raise ValueError(f"jacobian should have one number of rows in all leaves; found {sorted(counts)}")
        return tuple(zip(parts, stacked, strict=True))

    @cached_property
    def _given(self) -> list[list[Any]]:
        """Leaves as they came, in the order of g's: of g; and of J where it is stacked, else of each row."""
        own = leaves_of(self.gradient, self.gradient)
        if not own:
            raise ValueError("gradient should have at least one component; found none")
        if self._is_stacked:
            return [own, leaves_of(self.jacobian, self.gradient)]
        if not isinstance(self.jacobian, list | tuple):
            raise ValueError(
                "jacobian should be a list of rows with the structure of gradient, or have it, with the constraints as "
                f"first axis of every leaf; found {_describe(self.jacobian)}"
            )
        return [own, *(self._in_order(row, f"jacobian[{i}]") for i, row in enumerate(self.jacobian))]

    @cached_property
    def _is_stacked(self) -> bool:
        """Whether J is one tree whose leaves have the constraints as their first axis."""
        are_nodes = isinstance(self.gradient, NODES) and isinstance(self.jacobian, NODES)
        if are_nodes and len(self.jacobian) != len(self.gradient):  # rows, most often: which need no comparing
            return False
        if structure_of(self.jacobian) != self._structure:
            return False
        own, others = leaves_of(self.gradient, self.gradient), leaves_of(self.jacobian, self.gradient)
        return [*map(np.ndim, others)] == [1 + np.ndim(leaf) for leaf in own]

    @cached_property
    def _structure(self) -> Any:
        return structure_of(self.gradient)

    def _in_order(self, tree: Any, name: str) -> list[Any]:
        """Its leaves; ValueError for another structure than g's."""
        found = structure_of(tree)
        if found != self._structure:
            raise ValueError(f"{name} should have the structure of gradient, {self._structure}; found {found}")
        return leaves_of(tree, self.gradient)

    def _flat(self, name: str, leaves: list[Any], *, is_row: bool = True) -> list[Any]:
        """Leaves of one axis, or of two where J is stacked; copied where their numbers lie in another order.

        ValueError for other forms than g's. A row has g's dtypes and library too.
        """
        found, axes = [], int(name == "jacobian")
        for k, (leaf, like) in enumerate(zip(leaves, self._given[0], strict=True)):
            array, shape = self.look_at(leaf), tuple(getattr(like, "shape", ()))
            if array is None:
                self._refuse(name, k, "be an array of float64, float32 or bfloat16", _describe(leaf))
            if tuple(array.shape[axes:]) != shape:
                wanted = f"(m, {', '.join(map(str, shape))})" if axes else shape
                self._refuse(name, k, f"have shape {wanted}", tuple(array.shape))
            if is_row and _library(leaf) != _library(like):
                self._refuse(name, k, f"be of {_library(like)} as gradient is", _library(leaf))
            if is_row and leaf.dtype != like.dtype:
                self._refuse(name, k, f"be of {like.dtype} as gradient is there", leaf.dtype)
            if isinstance(leaf, np.ndarray) and type(leaf) is not np.ndarray and np.ma.is_masked(leaf):
                self._refuse(name, k, "have no masked entries, whose values nobody vouches for", "some")
            found.append(array.reshape(*array.shape[:axes], math.prod(shape)))
        return found

    def _refuse(self, name: str, k: int, wanted: str, found: Any) -> None:
        raise ValueError(f"{names_of(self.gradient, name)[k]} should {wanted}; found {found}")

    def look_at(self, leaf: Any) -> Any:
        """The array that a leaf is, without a copy, of bfloat16 its bits; None for what is no array of floats."""
        if _torch.is_tensor(leaf):
            return _torch.as_array(leaf) if _torch.is_float(leaf) else None
        array = _jax.as_array(leaf) if _jax.is_jax(leaf) else leaf
        if not isinstance(array, np.ndarray):
            return None
        if array.dtype.name == "bfloat16":  # of the package that brings it to NumPy
            return np.asarray(array).view(BFLOAT16)
        return np.asarray(array) if array.dtype in DTYPES else None

    @cached_property
    def _plain(self) -> tuple[Any, list[int], int] | None:
        """(dtype, numbers of each leaf, m) if all leaves are alike, and lie side by side; else None.

        So it is nearly always. Of hundreds of leaves each is asked a few questions, by loops that are not Python's.
        """
        own, *others = self._given
        of_torch = _torch.is_tensor(own[0])
        if not all(map(_torch.are_side_by_side if of_torch else _are_side_by_side, self._given)):
            return None
        forms = [*map(_FORM, own)]
        dtype, m = forms[0][0], len(others)
        if len({dtype for dtype, _ in forms}) > 1:
            return None
        counts = [math.prod(shape) for _, shape in forms]
        if self._is_stacked:
            m = len(others[0][0])
            forms = [(dtype, (m, *shape)) for _, shape in forms]
        dtype = _torch.NUMPYS[str(dtype)] if of_torch else dtype
        return (dtype, counts, m) if all([*map(_FORM, row)] == forms for row in others) else None

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n), by the rows."""
        return super().shape if self._plain is None else (self._plain[2], sum(self._plain[1]))

    @cached_property
    def _groups(self) -> list[Group]:
        """By the addresses alone, where all is plain."""
        if self._plain is None:
            return super()._groups
        (dtype, counts, m), (own, *others) = self._plain, self._given
        find = _torch.addresses if _torch.is_tensor(own[0]) else addresses
        where, sizes = np.empty((len(own), 1 + m, 4), np.int64), np.array(counts)[:, None]
        where[:, :, 1], where[:, :, 2], where[:, :, 3] = dtype.itemsize, sizes, dtype.itemsize
        where[:, 0, 0] = find(own)
        if self._is_stacked:
            where[:, 1:, 0] = np.array(find(others[0]))[:, None] + np.arange(m) * sizes * dtype.itemsize
        else:
            for i, row in enumerate(others):
                where[:, 1 + i, 0] = find(row)
        spans = pairwise(accumulate(counts, initial=0))
        return [(dtype, [(k, start, end) for k, (start, end) in enumerate(spans)], where)]

    def channels(self) -> list[Any]:
        """g and J's rows, each in the form of g."""
        if self._is_stacked:
            return [self.gradient, *(map_leaves(itemgetter(i), self.jacobian) for i in range(self.shape[0]))]
        return [self.gradient, *self.jacobian]

    def rebuild(self, parts: list[Any]) -> Any:
        """In g's structure, shapes and kind."""
        own = self._given[0]
        back = _torch.as_tensor if _torch.is_tensor(own[0]) else _jax.as_jax if _jax.is_jax(own[0]) else _as_array
        left = map(back, parts, own)
        return map_leaves(lambda _: next(left), self.gradient)

    def in_float64(self, row: np.ndarray) -> Any:
        """A vector in the form of g, of float64 whatever the leaves are."""
        return self.rebuild(self.split(row))

    def take_apart(self, direction: Any, name: str = "direction.value") -> list[Any]:
        """Flat; ValueError for another structure or other shapes than g's. All in one array is all right too."""
        if type(direction) is np.ndarray and direction.ndim == 1 and direction.dtype == np.float64:
            if len(direction) != self.shape[1]:
                raise ValueError(f"{name} should have shape {(self.shape[1],)}; found {direction.shape}")
            parts: list[Any] = self.split(direction)
        else:
            parts = self._flat(name, self._in_order(direction, name), is_row=False)
        return [self.place(part, g) for part, (g, _) in zip(parts, self.leaves, strict=True)]

    def place(self, part: Any, like: Any) -> Any:
        """Contiguous, of the dtype of g's part or else of float64."""
        return np.ascontiguousarray(part if part.dtype == like.dtype else np.asarray(self.host(part), np.float64))


def is_tree(gradient: Any) -> bool:
    """Whether it is a tree of arrays, a tensor of another library, or an array of other floats than float64."""
    if isinstance(gradient, np.ndarray):
        return bool(gradient.dtype.kind == "f" and gradient.dtype.itemsize != _WIDE)
    if isinstance(gradient, dict):
        return True
    if isinstance(gradient, list | tuple):
        return any(is_tree(part) or (_is_array(part) and part.ndim > 0) for part in gradient)
    return _is_array(gradient)


def _are_side_by_side(arrays: list[Any]) -> bool:
    """Whether they are arrays of NumPy that the passes read as they lie."""
    if {*map(type, arrays)} != {np.ndarray} or arrays[0].dtype not in DTYPES:
        return False
    return all(map(attrgetter("flags.c_contiguous"), arrays))


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) or _torch.is_tensor(value) or _jax.is_jax(value)


def _describe(leaf: Any) -> str:
    if hasattr(leaf, "dtype"):
        return f"{type(leaf).__name__} of {leaf.dtype}, shape {tuple(leaf.shape)}"
    return f"{structure_of(leaf)}" if isinstance(leaf, NODES) else repr(leaf)


def _library(leaf: Any) -> str:
    if _torch.is_tensor(leaf):
        return f"torch on {leaf.device}" if _torch.is_apart(leaf) else "torch"
    return "jax" if _jax.is_jax(leaf) else type(leaf).__module__.partition(".")[0]


def _as_array(part: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The flat array as the leaf that it stands for."""
    return np.asarray(part.view(like.dtype) if part.dtype == BFLOAT16 else part).reshape(like.shape)
