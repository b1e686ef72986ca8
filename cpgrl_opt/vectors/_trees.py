"""Trees of arrays: a list, tuple or dict, nested, of parameter-shaped arrays; one array is a tree of one leaf.

g has the structure of the parameters. J has it too, every leaf with the constraints as its first axis, as a Jacobian by
automatic differentiation comes; or it is a list of such trees, one a row. Leaves are NumPy's, PyTorch's or JAX's, of
float64, float32 or bfloat16. All are read where they lie, and d comes back as g came: structure, shapes, dtypes.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import Any

import numpy as np

from . import _jax, _torch
from ._numpy import BFLOAT16, DTYPES, Leaf, LeafVectors

Path = tuple[Any, ...]  # keys from a tree's root to a leaf
_LISTS, _NODES = (list, tuple), (list, tuple, dict)
_WIDE = 8  # bytes of a float64, in either order


@dataclass(frozen=True, eq=False)
class TreeVectors(LeafVectors):
    """g and J as they were handed over."""

    gradient: Any
    jacobian: Any

    def __getstate__(self) -> dict[str, Any]:
        """Without what was found: the arrays of a copy lie elsewhere."""
        return {"gradient": self.gradient, "jacobian": self.jacobian}

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        """g's part, flat, and J's as (m, k) or as rows apart; ValueError for what does not fit."""
        own = self._own
        parts = [self._floats("gradient", path, leaf).reshape(-1) for path, leaf in own]
        if not parts:
            raise ValueError("gradient should have at least one component; found none")
        for path, leaf in own[1:]:
            _require_library("gradient", path, leaf, own[0][1])
        if self._is_stacked:
            rows: list[Any] = [self._stacked(path, leaf) for path, leaf in own]
            if len(counts := {len(part) for part in rows}) > 1:
                raise ValueError(f"jacobian should have one number of rows in all leaves; found {sorted(counts)}")
        elif not isinstance(self.jacobian, list | tuple):
            raise ValueError(
                "jacobian should be a list of rows with the structure of gradient, or have it, with the constraints as "
                f"first axis of every leaf; found {_described(self.jacobian)}"
            )
        else:
            listed = (self._flat(row, f"jacobian[{i}]", is_row=True) for i, row in enumerate(self.jacobian))
            rows = list(zip(*listed, strict=True)) or [()] * len(parts)
        return tuple(zip(parts, rows, strict=True))

    @cached_property
    def _own(self) -> list[tuple[Path, Any]]:
        """Of g."""
        return list(walk(self.gradient))

    @cached_property
    def _is_stacked(self) -> bool:
        """Whether J is one tree whose leaves have the constraints as their first axis."""
        return _is_alike(self.jacobian, self.gradient) and all(
            np.ndim(_at(path, self.jacobian)) == np.ndim(leaf) + 1 for path, leaf in self._own
        )

    def _flat(self, tree: Any, name: str, *, is_row: bool) -> list[Any]:
        """Leaves of one axis, copied where their numbers lie in another order than NumPy's; ValueError for other forms.

        A row has g's dtypes too.
        """
        _require_structure(name, tree, self.gradient)
        found = []
        for path, like in self._own:
            leaf = _at(path, tree)
            array = self._floats(name, path, leaf)
            if array.shape != like.shape:
                raise ValueError(
                    f"{_named(name, path)} should have shape {tuple(like.shape)}; found {tuple(array.shape)}"
                )
            if is_row:
                _require_dtype(name, path, leaf, like)
            found.append(array.reshape(-1))
        return found

    def _stacked(self, path: Path, like: Any) -> Any:
        """(m, k)."""
        leaf, shape = _at(path, self.jacobian), tuple(like.shape)
        array = self._floats("jacobian", path, leaf)
        if tuple(array.shape[1:]) != shape:
            raise ValueError(
                f"{_named('jacobian', path)} should have shape (m, {', '.join(map(str, shape))}); "
                f"found {tuple(array.shape)}"
            )
        _require_dtype("jacobian", path, leaf, like)
        return array.reshape(len(array), math.prod(shape))

    def _floats(self, name: str, path: Path, leaf: Any) -> Any:
        array = self.looked_at(leaf)
        if array is None:
            raise ValueError(
                f"{_named(name, path)} should be an array of float64, float32 or bfloat16; found {_described(leaf)}"
            )
        if type(array) is np.ndarray or not isinstance(array, np.ndarray):
            return array
        if np.ma.is_masked(array):
            raise ValueError(
                f"{_named(name, path)} should have no masked entries, whose values nobody vouches for; found some"
            )
        return np.asarray(array)

    def looked_at(self, leaf: Any) -> Any:
        """The array that a leaf is, without a copy, of bfloat16 its bits; None for what is no array of floats."""
        if type(leaf) is np.ndarray and leaf.dtype in DTYPES:  # first, since of a tree there may be hundreds
            return leaf
        if _torch.is_tensor(leaf):
            return _torch.as_array(leaf) if _torch.is_float(leaf) else None
        array = _jax.as_array(leaf) if _jax.is_jax(leaf) else leaf
        if not isinstance(array, np.ndarray):
            return None
        if array.dtype in DTYPES:
            return array
        return (
            array.view(BFLOAT16) if array.dtype.name == "bfloat16" else None
        )  # of the package that brings it to NumPy

    def channels(self) -> list[Any]:
        """g and J's rows, each in the form of g."""
        if self._is_stacked:
            return [self.gradient, *(mapped(itemgetter(i), self.jacobian) for i in range(self.shape[0]))]
        return [self.gradient, *self.jacobian]

    def rebuilt(self, parts: list[Any]) -> Any:
        """In g's structure, shapes and kind."""
        left = iter(parts)
        return mapped(lambda leaf: _back(next(left), leaf), self.gradient)

    def unrounded(self, row: np.ndarray) -> Any:
        """A vector in the form of g, of float64 whatever the leaves are."""
        return self.rebuilt(self.split(row))

    def taken_apart(self, direction: Any, name: str = "direction.value") -> list[Any]:
        """Flat; ValueError for another structure or other shapes than g's. All in one array is all right too."""
        if type(direction) is np.ndarray and direction.ndim == 1 and direction.dtype == np.float64:
            if len(direction) != self.shape[1]:
                raise ValueError(f"{name} should have shape {(self.shape[1],)}; found {direction.shape}")
            parts: list[Any] = self.split(direction)
        else:
            parts = self._flat(direction, name, is_row=False)
        return [self.placed(part, g) for part, (g, _) in zip(parts, self.leaves, strict=True)]

    def placed(self, part: Any, like: Any) -> Any:
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


def _is_node(value: Any) -> bool:
    return isinstance(value, _NODES)


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) or _torch.is_tensor(value) or _jax.is_jax(value)


def walk(tree: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """(keys from the root, leaf), in the order of the keys."""
    if isinstance(tree, list | tuple | dict):
        for key in tree if isinstance(tree, dict) else range(len(tree)):
            yield from walk(tree[key], (*path, key))
    else:
        yield path, tree


def _at(path: Path, tree: Any) -> Any:
    """The leaf of a tree."""
    for key in path:
        tree = tree[key]
    return tree


def _named(name: str, path: Path) -> str:
    """As the caller would write it."""
    return name + "".join(f"[{key!r}]" for key in path)


def mapped(change: Callable[[Any], Any], tree: Any) -> Any:
    """The tree of changed leaves; named tuples stay what they are."""
    if isinstance(tree, dict):
        return {key: mapped(change, part) for key, part in tree.items()}
    if isinstance(tree, list):
        return [mapped(change, part) for part in tree]
    if isinstance(tree, tuple):
        parts = [mapped(change, part) for part in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    return change(tree)


def _structure(tree: Any) -> Any:
    """What two trees of one structure have alike."""
    if isinstance(tree, dict):
        return {key: _structure(part) for key, part in tree.items()}
    return [_structure(part) for part in tree] if isinstance(tree, list | tuple) else None


def _is_alike(tree: Any, like: Any) -> bool:
    """Whether two trees have one structure."""
    if isinstance(like, dict):
        return isinstance(tree, dict) and tree.keys() == like.keys() and all(_is_alike(tree[k], like[k]) for k in like)
    if _is_node(like):
        return isinstance(tree, _LISTS) and len(tree) == len(like) and all(map(_is_alike, tree, like))
    return not _is_node(tree)


def _require_structure(name: str, tree: Any, like: Any) -> None:
    if not _is_alike(tree, like):
        wanted, found = _structure(like), _structure(tree)
        raise ValueError(f"{name} should have the structure of gradient, {wanted}; found {found}")


def _described(leaf: Any) -> str:
    if hasattr(leaf, "dtype"):
        return f"{type(leaf).__name__} of {leaf.dtype}, shape {tuple(leaf.shape)}"
    return f"{_structure(leaf)}" if _is_node(leaf) else repr(leaf)


def _library(leaf: Any) -> str:
    if _torch.is_tensor(leaf):
        return f"torch on {leaf.device}" if _torch.is_apart(leaf) else "torch"
    return "jax" if _jax.is_jax(leaf) else type(leaf).__module__.partition(".")[0]


def _require_library(name: str, path: Path, leaf: Any, like: Any) -> None:
    """ValueError for a leaf of another library or device than g's."""
    if type(leaf) is type(like) and leaf.device == like.device:
        return
    found, wanted = _library(leaf), _library(like)
    if found != wanted:
        raise ValueError(f"{_named(name, path)} should be of {wanted} as gradient is; found {found}")


def _require_dtype(name: str, path: Path, leaf: Any, like: Any) -> None:
    """ValueError for a row of another library, device or dtype than g's part."""
    _require_library(name, path, leaf, like)
    if leaf.dtype != like.dtype:
        raise ValueError(f"{_named(name, path)} should be of {like.dtype} as gradient is there; found {leaf.dtype}")


def _back(part: np.ndarray, like: Any) -> Any:
    """The flat array as the leaf that it stands for."""
    if _torch.is_tensor(like):
        return _torch.as_tensor(part, like)
    if _jax.is_jax(like):
        return _jax.as_jax(part, like)
    return np.asarray(part.view(like.dtype) if part.dtype == BFLOAT16 else part).reshape(like.shape)
