"""Gradients as JAX's users have them → leaves (channels, k); ValueError for what does not fit, while it is traced."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def read_gradients(
    gradients: Any, channels: int, name: str = "gradients", like: Any = None
) -> tuple[list[Any], Callable[[list[Any]], Any]]:
    """Leaves (channels, k), and how a vector of such leaves becomes a tree again.

    gradients: a tree with the channels as first axis of every leaf, or a list of as many trees. like: a tree of the
    shapes that each channel should have, where it is known.
    """
    if like is not None and isinstance(gradients, list) and jax.tree.structure(gradients) != jax.tree.structure(like):
        gradients = _stack(gradients, channels, name)
    is_stacked = all(jnp.ndim(leaf) > 0 and jnp.shape(leaf)[0] == channels for leaf in jax.tree.leaves(gradients))
    if like is None and isinstance(gradients, list) and len(gradients) == channels and _are_alike(gradients):
        if is_stacked:
            raise ValueError(
                f"{name} should be a tree with the channels as first axis of every leaf, or a list of trees; found "
                "what may be either: stack the trees, jax.tree.map(lambda *rows: jnp.stack(rows), *rows)"
            )
        gradients = _stack(gradients, channels, name)
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

    def rebuild(parts: list[Any]) -> Any:
        return jax.tree.unflatten(form, [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)])

    return [
        jnp.reshape(leaf, (channels, math.prod(shape))) for leaf, shape in zip(leaves, shapes, strict=True)
    ], rebuild


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
    except TypeError as error:
        raise ValueError(f"{name} should be real numbers; found {values!r}") from error
    if array.ndim != 1 or (length is not None and len(array) != length):
        raise ValueError(f"{name} should have shape ({'any' if length is None else length},); found {array.shape}")
    if jnp.issubdtype(array.dtype, jnp.complexfloating) or array.dtype == bool:
        raise ValueError(f"{name} should be real numbers; found {array.dtype}")
    return array.astype(jnp.result_type(float))
