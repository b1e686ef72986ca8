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
        names = dict(walk(self.gradient, "gradient"))
        parts = [self._floats(name, leaf).reshape(-1) for name, leaf in names.items()]
        if not parts:
            raise ValueError("gradient should have at least one component; found none")
        first = next(iter(names.values()))
        for name, leaf in names.items():
            _require_library(name, leaf, first)
        if _is_stacked(self.gradient, self.jacobian):
            pairs = zip(walk(self.jacobian, "jacobian", self.gradient), names.values(), strict=True)
            rows: list[Any] = [self._stacked(*pair, like) for pair, like in pairs]
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

    def _flat(self, tree: Any, name: str, *, is_row: bool) -> list[Any]:
        """Leaves of one axis, copied where their numbers lie in another order than NumPy's; ValueError for other forms.

        A row has g's dtypes too.
        """
        _require_structure(name, tree, self.gradient)
        found = []
        for (own, leaf), (_, like) in zip(walk(tree, name, self.gradient), walk(self.gradient, ""), strict=True):
            array = self._floats(own, leaf)
            if array.shape != like.shape:
                raise ValueError(f"{own} should have shape {tuple(like.shape)}; found {tuple(array.shape)}")
            if is_row:
                _require_dtype(own, leaf, like)
            found.append(array.reshape(-1))
        return found

    def _stacked(self, name: str, leaf: Any, like: Any) -> Any:
        """(m, k)."""
        array, shape = self._floats(name, leaf), tuple(like.shape)
        if tuple(array.shape[1:]) != shape:
            raise ValueError(f"{name} should have shape (m, {', '.join(map(str, shape))}); found {tuple(array.shape)}")
        _require_dtype(name, leaf, like)
        return array.reshape(len(array), math.prod(shape))

    def _floats(self, name: str, leaf: Any) -> Any:
        array = self.looked_at(leaf)
        if array is None:
            raise ValueError(f"{name} should be an array of float64, float32 or bfloat16; found {_described(leaf)}")
        if np.ma.is_masked(array):
            raise ValueError(f"{name} should have no masked entries, whose values nobody vouches for; found some")
        return np.asarray(array) if isinstance(array, np.ndarray) else array

    def looked_at(self, leaf: Any) -> Any:
        """The array that a leaf is, without a copy, of bfloat16 its bits; None for what is no array of floats."""
        if _torch.is_tensor(leaf):
            return _torch.as_array(leaf) if _torch.is_float(leaf) else None
        array = _jax.as_array(leaf) if _jax.is_jax(leaf) else leaf
        if not isinstance(array, np.ndarray):
            return None
        if array.dtype.name == "bfloat16":  # of the package that brings it to NumPy
            return array.view(BFLOAT16)
        return array if array.dtype in DTYPES else None

    def channels(self) -> list[Any]:
        """g and J's rows, each in the form of g."""
        if _is_stacked(self.gradient, self.jacobian):
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
    """Whether it is a tree of arrays, a tensor of another library, or an array of float32."""
    if isinstance(gradient, np.ndarray):
        return bool(gradient.dtype == np.float32)
    if isinstance(gradient, dict):
        return True
    if isinstance(gradient, list | tuple):
        return any(is_tree(part) or (_is_array(part) and part.ndim > 0) for part in gradient)
    return _is_array(gradient)


def _is_node(value: Any) -> bool:
    return isinstance(value, list | tuple | dict)


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) or _torch.is_tensor(value) or _jax.is_jax(value)


def walk(tree: Any, name: str, like: Any = None) -> Iterator[tuple[str, Any]]:
    """(name, leaf), in the order of the keys of `like`, a tree of the same structure; None: of its own."""
    like = tree if like is None else like
    if isinstance(like, list | tuple | dict):
        for key in like if isinstance(like, dict) else range(len(like)):
            yield from walk(tree[key], f"{name}[{key!r}]", like[key])
    else:
        yield name, tree


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


def _require_structure(name: str, tree: Any, like: Any) -> None:
    found, wanted = _structure(tree), _structure(like)
    if found != wanted:
        raise ValueError(f"{name} should have the structure of gradient, {wanted}; found {found}")


def _is_stacked(gradient: Any, jacobian: Any) -> bool:
    """Whether J is one tree whose leaves have the constraints as their first axis."""
    if _structure(jacobian) != _structure(gradient):
        return False
    pairs = zip(walk(jacobian, "", gradient), walk(gradient, ""), strict=True)
    return all(np.ndim(rows) == np.ndim(leaf) + 1 for (_, rows), (_, leaf) in pairs)


def _described(leaf: Any) -> str:
    if hasattr(leaf, "dtype"):
        return f"{type(leaf).__name__} of {leaf.dtype}, shape {tuple(leaf.shape)}"
    return f"{_structure(leaf)}" if _is_node(leaf) else repr(leaf)


def _library(leaf: Any) -> str:
    if _torch.is_tensor(leaf):
        return f"torch on {leaf.device}" if _torch.is_apart(leaf) else "torch"
    return "jax" if _jax.is_jax(leaf) else type(leaf).__module__.partition(".")[0]


def _require_library(name: str, leaf: Any, like: Any) -> None:
    """ValueError for a leaf of another library or device than g's."""
    found, wanted = _library(leaf), _library(like)
    if found != wanted:
        raise ValueError(f"{name} should be of {wanted} as gradient is; found {found}")


def _require_dtype(name: str, leaf: Any, like: Any) -> None:
    """ValueError for a row of another library, device or dtype than g's part."""
    _require_library(name, leaf, like)
    if leaf.dtype != like.dtype:
        raise ValueError(f"{name} should be of {like.dtype} as gradient is there; found {leaf.dtype}")


def _back(part: np.ndarray, like: Any) -> Any:
    """The flat array as the leaf that it stands for."""
    if _torch.is_tensor(like):
        return _torch.as_tensor(part, like)
    if _jax.is_jax(like):
        return _jax.as_jax(part, like)
    return np.asarray(part.view(like.dtype) if part.dtype == BFLOAT16 else part).reshape(like.shape)
