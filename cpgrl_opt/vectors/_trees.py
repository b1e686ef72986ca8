"""Trees of arrays: a list, tuple or dict, nested, of parameter-shaped arrays; one array is a tree of one leaf.

g has the structure of the parameters. J has it too, every leaf with the constraints as its first axis, as a Jacobian by
automatic differentiation comes; or it is a list of such trees, one a row. Leaves are NumPy's, PyTorch's on the CPU or
JAX's, of float64 or float32. All are read where they lie, and d comes back as g came: structure, shapes, dtypes.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import Any

import numpy as np

from ._numpy import DTYPES, Leaf, LeafVectors
from ._operations import OperationVectors, has_operations
from .interface import Vectors


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
        names = dict(_walk(self.gradient, "gradient"))
        parts = [_flat(name, leaf) for name, leaf in names.items()]
        if not any(map(len, parts)):
            raise ValueError("gradient should have at least one component; found none")
        if _is_stacked(self.gradient, self.jacobian):
            rows: list[Any] = [
                _stacked(name, leaf, _array(like))
                for (name, leaf), like in zip(
                    _walk(self.jacobian, "jacobian", self.gradient), names.values(), strict=True
                )
            ]
            if len(counts := {len(part) for part in rows}) > 1:
                raise ValueError(f"jacobian should have one number of rows in all leaves; found {sorted(counts)}")
        elif not isinstance(self.jacobian, list | tuple):
            raise ValueError(
                "jacobian should be a list of rows with the structure of gradient, or have it, with the constraints as "
                f"first axis of every leaf; found {_described(self.jacobian)}"
            )
        else:
            rows = list(zip(*map(self._row, range(len(self.jacobian))), strict=True)) or [()] * len(parts)
        _require_one_kind(names, self.jacobian)
        return tuple(zip(parts, rows, strict=True))

    def _row(self, index: int) -> list[np.ndarray]:
        name, row = f"jacobian[{index}]", self.jacobian[index]
        _require_structure(name, row, self.gradient)
        pairs = zip(_walk(row, name, self.gradient), _walk(self.gradient, "gradient"), strict=True)
        return [_flat(own, leaf, np.shape(_array(like))) for (own, leaf), (_, like) in pairs]

    def channels(self) -> list[Any]:
        """g and J's rows, each in the form of g."""
        if _is_stacked(self.gradient, self.jacobian):
            return [self.gradient, *(_mapped(itemgetter(i), self.jacobian) for i in range(self.shape[0]))]
        return [self.gradient, *self.jacobian]

    def rebuilt(self, parts: list[np.ndarray]) -> Any:
        """In g's structure, shapes and kind."""
        left = iter(parts)
        return _mapped(lambda leaf: _back(next(left), leaf), self.gradient)

    def unrounded(self, row: np.ndarray) -> Any:
        """A vector in the form of g, of float64 whatever the leaves are."""
        ends = np.cumsum([len(g) for g, _ in self.leaves])[:-1]
        return self.rebuilt(np.split(row, ends))

    def taken_apart(self, direction: Any, name: str = "direction.value") -> list[np.ndarray]:
        """Flat; ValueError for another structure or other shapes than g's. All in one array is all right too."""
        if type(direction) is np.ndarray and direction.ndim == 1 and direction.dtype == np.float64:
            if len(direction) != self.shape[1]:
                raise ValueError(f"{name} should have shape {(self.shape[1],)}; found {direction.shape}")
            return np.split(direction, np.cumsum([len(g) for g, _ in self.leaves])[:-1])
        _require_structure(name, direction, self.gradient)
        pairs = zip(_walk(direction, name, self.gradient), _walk(self.gradient, "gradient"), strict=True)
        flat = (_flat(own, leaf, np.shape(_array(like))) for (own, leaf), (_, like) in pairs)
        return [np.ascontiguousarray(part) for part in flat]


def is_tree(gradient: Any) -> bool:
    """Whether it is a tree of arrays, a tensor of another library, or an array of float32."""
    if isinstance(gradient, np.ndarray):
        return bool(gradient.dtype == np.float32)
    if isinstance(gradient, dict):
        return True
    if isinstance(gradient, list | tuple):
        return any(is_tree(part) or (_is_array(part) and np.ndim(_array(part)) > 0) for part in gradient)
    return _is_array(gradient)


def channels_of(gradients: Any) -> Vectors | None:
    """The gradients of one run, the objective's first: a list of trees, or one with the channels as first axis.

    None for what is no tree and no object of the caller's. Arrays of float64 in a list are rows of one array.
    """
    if isinstance(gradients, Vectors) or has_operations(gradients):
        return gradients if isinstance(gradients, Vectors) else OperationVectors(gradients)
    if isinstance(gradients, list | tuple):
        if not gradients or not is_tree(gradients[0]):
            return None
        return TreeVectors(gradients[0], list(gradients[1:]))
    if not is_tree(gradients) or (isinstance(gradients, np.ndarray) and gradients.ndim != 2):
        return None
    return TreeVectors(_mapped(itemgetter(0), gradients), _mapped(itemgetter(slice(1, None)), gradients))


def _is_node(value: Any) -> bool:
    return isinstance(value, list | tuple | dict)


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) or _is_tensor(value) or _is_jax(value)


def _is_tensor(value: Any) -> bool:
    torch = sys.modules.get("torch")  # whoever has a tensor has imported it
    return torch is not None and isinstance(value, torch.Tensor)


def _is_jax(value: Any) -> bool:
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(value, jax.Array)


def _walk(tree: Any, name: str, like: Any = None) -> Iterator[tuple[str, Any]]:
    """(name, leaf), in the order of the keys of `like`, a tree of the same structure; None: of its own."""
    like = tree if like is None else like
    if isinstance(like, list | tuple | dict):
        for key in like if isinstance(like, dict) else range(len(like)):
            yield from _walk(tree[key], f"{name}[{key!r}]", like[key])
    else:
        yield name, tree


def _mapped(change: Callable[[Any], Any], tree: Any) -> Any:
    """The tree of changed leaves; named tuples stay what they are."""
    if isinstance(tree, dict):
        return {key: _mapped(change, part) for key, part in tree.items()}
    if isinstance(tree, list):
        return [_mapped(change, part) for part in tree]
    if isinstance(tree, tuple):
        parts = [_mapped(change, part) for part in tree]
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
    pairs = zip(_walk(jacobian, "", gradient), _walk(gradient, ""), strict=True)
    return all(np.ndim(_array(rows)) == np.ndim(_array(leaf)) + 1 for (_, rows), (_, leaf) in pairs)


def _array(leaf: Any) -> Any:
    """What NumPy sees of a leaf, without a copy."""
    if _is_tensor(leaf):
        if leaf.device.type != "cpu" or leaf.layout is not sys.modules["torch"].strided:
            raise ValueError(f"tensors should be dense and on the CPU; found {leaf.layout} on {leaf.device}")
        return leaf.detach().numpy() if leaf.dtype in _tensor_dtypes() else leaf
    return np.asarray(leaf) if _is_jax(leaf) else leaf


def _tensor_dtypes() -> tuple[Any, ...]:
    torch = sys.modules["torch"]
    return torch.float64, torch.float32


def _flat(name: str, leaf: Any, shape: tuple[Any, ...] | None = None) -> np.ndarray:
    """One axis; a copy only where its numbers lie in another order than NumPy's."""
    array = _require_floats(name, leaf)
    if shape is not None and array.shape != shape:
        raise ValueError(f"{name} should have shape {shape}; found {array.shape}")
    return array.reshape(-1)


def _stacked(name: str, leaf: Any, like: Any) -> np.ndarray:
    """(m, k)."""
    array = _require_floats(name, leaf)
    if array.shape[1:] != like.shape:
        raise ValueError(f"{name} should have shape (m, {', '.join(map(str, like.shape))}); found {array.shape}")
    return array.reshape(len(array), like.size)


def _require_floats(name: str, leaf: Any) -> np.ndarray:
    array = _array(leaf)
    if not isinstance(array, np.ndarray) or array.dtype not in DTYPES:
        raise ValueError(f"{name} should be an array of float64 or float32; found {_described(leaf)}")
    if np.ma.is_masked(array):
        raise ValueError(f"{name} should have no masked entries, whose values nobody vouches for; found some")
    return np.asarray(array)


def _described(leaf: Any) -> str:
    if hasattr(leaf, "dtype"):
        return f"{type(leaf).__name__} of {leaf.dtype}, shape {tuple(leaf.shape)}"
    return f"{_structure(leaf)}" if _is_node(leaf) else repr(leaf)


def _library(leaf: Any) -> str:
    return "torch" if _is_tensor(leaf) else "jax" if _is_jax(leaf) else type(leaf).__module__.partition(".")[0]


def _require_one_kind(names: dict[str, Any], jacobian: Any) -> None:
    """ValueError for gradient and jacobian of several libraries; leaves may differ in dtype, a leaf's rows may not."""
    libraries = {_library(leaf) for leaf in names.values()} | {_library(leaf) for _, leaf in _walk(jacobian, "")}
    if len(libraries) > 1:
        raise ValueError(f"gradient and jacobian should be arrays of one library; found {', '.join(sorted(libraries))}")


def _back(part: np.ndarray, like: Any) -> Any:
    """The flat array as the leaf that it stands for."""
    if _is_tensor(like):
        return sys.modules["torch"].from_numpy(part).reshape(like.shape)
    if _is_jax(like):
        return sys.modules["jax"].numpy.asarray(part.reshape(like.shape))
    return part.reshape(like.shape)
