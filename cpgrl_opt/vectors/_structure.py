"""The structure of trees: lists, tuples and dicts, nested, around leaves of any kind."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

NODES = (list, tuple, dict)


def structure_of(tree: Any) -> Any:
    """What two trees of one structure have alike; of a leaf None."""
    if not isinstance(tree, NODES):
        return None
    parts = tree.values() if isinstance(tree, dict) else tree
    found = [*map(structure_of, parts)] if _has_nodes(parts) else [None] * len(parts)
    return dict(zip(tree, found, strict=True)) if isinstance(tree, dict) else found


def leaves_of(tree: Any, like: Any) -> list[Any]:
    """Leaves in the order of a tree of the same structure."""
    if not isinstance(like, NODES):
        return [tree]
    keys = [*like] if isinstance(like, dict) else range(len(like))
    parts = [tree[key] for key in keys]
    if not _has_nodes(parts):
        return parts
    return [leaf for key, part in zip(keys, parts, strict=True) for leaf in leaves_of(part, like[key])]


def map_leaves(change: Callable[[Any], Any], tree: Any) -> Any:
    """The tree of changed leaves; named tuples stay what they are."""
    if not isinstance(tree, NODES):
        return change(tree)
    values = tree.values() if isinstance(tree, dict) else tree
    parts = [*map(partial(map_leaves, change) if _has_nodes(values) else change, values)]
    if isinstance(tree, dict):
        return dict(zip(tree, parts, strict=True))
    if isinstance(tree, list):
        return parts
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)


def names_of(tree: Any, name: str) -> list[str]:
    """Of the leaves, as the caller would write them."""
    if not isinstance(tree, NODES):
        return [name]
    keys = tree if isinstance(tree, dict) else range(len(tree))
    return [leaf for key in keys for leaf in names_of(tree[key], f"{name}[{key!r}]")]


def _has_nodes(parts: Iterable[Any]) -> bool:
    """Of a layer with a hundred leaves most often none: then none of them is asked by itself."""
    return any(issubclass(kind, NODES) for kind in {*map(type, parts)})
