"""Gradients as JAX's users have them → leaves (channels, k); ValueError for what does not fit, while it is traced."""

from collections.abc import Callable, Hashable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp


def names_of(thresholds: Any) -> tuple[Hashable, ...] | None:
    """Those of constraints whose thresholds came as a dict."""
    return tuple(thresholds) if isinstance(thresholds, Mapping) else None


def list_by_name(name: str, given: Any, names: tuple[Hashable, ...]) -> list[Any]:
    """What is given by name, in the order of the thresholds."""
    if not isinstance(given, Mapping) or {*given} != {*names}:
        found = f"names {', '.join(map(str, given))}" if isinstance(given, Mapping) else type(given).__name__
        raise ValueError(f"{name} should be a dict with the names {', '.join(map(str, names))}; found {found}")
    return [given[each] for each in names]


def split_by_name(name: str, given: Any, names: tuple[Hashable, ...]) -> list[Any]:
    """The loss's, and the constraints' in the order of the thresholds."""
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise ValueError(f"{name} should be a pair, the loss's and a dict by name as thresholds are; found {given!r}")
    return [given[0], *list_by_name(f"{name} of constraints", given[1], names)]


def read_gradients(
    gradients: Any, channels: int, name: str = "gradients", like: Any = None, is_listed: bool = False
) -> tuple[list[Any], Callable[[list[Any]], Any]]:
    """Leaves (channels, …), and how a vector of such leaves becomes a tree again.

    gradients: a tree with the channels as first axis of every leaf, or a list of as many trees; is_listed: surely the
    latter. like: a tree of the shapes that each channel should have, where it is known.
    """
    gradients = (_stack if is_listed else partial(_stack_if_listed, like=like))(gradients, channels, name)
    leaves, form = jax.tree.flatten(gradients)
    if not leaves:
        raise ValueError(f"{name} should have at least one array; found none")
    for leaf in leaves:
        if not jnp.issubdtype(jnp.result_type(leaf), jnp.floating):
            raise ValueError(f"{name} should be of real floats; found {jnp.result_type(leaf)}")
        if jnp.ndim(leaf) == 0 or jnp.shape(leaf)[0] != channels:
            raise ValueError(
                f"{name} should have {channels} channels as first axis of each leaf; found {jnp.shape(leaf)}"
            )
    shapes = [jnp.shape(leaf)[1:] for leaf in leaves]
    if like is not None:
        wanted = jax.tree.structure(like), [*map(jnp.shape, jax.tree.leaves(like))]
        if wanted != (form, shapes):
            raise ValueError(f"{name} should have the structure and shapes of the parameters; found {form}, {shapes}")

    return [jnp.asarray(leaf) for leaf in leaves], partial(jax.tree.unflatten, form)


def _stack_if_listed(gradients: Any, channels: int, name: str, like: Any) -> Any:
    """ValueError where a list may be either."""
    if not isinstance(gradients, list):
        return gradients
    if like is not None:
        is_tree = jax.tree.structure(gradients) == jax.tree.structure(like)
        return gradients if is_tree else _stack(gradients, channels, name)
    if len(gradients) != channels or not _are_alike(gradients):
        return gradients
    if all(jnp.ndim(leaf) > 0 and jnp.shape(leaf)[0] == channels for leaf in jax.tree.leaves(gradients)):
        raise ValueError(
            f"{name} should be a tree with the channels as first axis of every leaf, or a list of trees; found "
            "what may be either: stack the trees, jax.tree.map(lambda *rows: jnp.stack(rows), *rows)"
        )
    return _stack(gradients, channels, name)


def _stack(trees: list[Any], channels: int, name: str) -> Any:
    if len(trees) != channels or not trees or not _are_alike(trees):
        raise ValueError(f"{name} should be {channels} trees of one structure and shapes; found {len(trees)}")
    return jax.tree.map(lambda *rows: jnp.stack(rows), *trees)


def _are_alike(trees: list[Any]) -> bool:
    forms = [(jax.tree.structure(tree), [*map(jnp.shape, jax.tree.leaves(tree))]) for tree in trees]
    return all(form == forms[0] for form in forms)


def real_vector(name: str, values: Any, length: int | None = None) -> Any:
    """A vector of the widest float; ValueError for another shape, or for what are no real numbers."""
    try:
        array = jnp.asarray(values)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} should be real numbers; found {values!r}") from error
    if array.ndim != 1 or (length is not None and len(array) != length):
        raise ValueError(f"{name} should have shape ({'any' if length is None else length},); found {array.shape}")
    if jnp.issubdtype(array.dtype, jnp.complexfloating) or array.dtype == bool:
        raise ValueError(f"{name} should be real numbers; found {array.dtype}")
    return array.astype(jnp.result_type(float))
