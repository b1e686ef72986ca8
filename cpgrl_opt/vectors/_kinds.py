"""Which kind of vectors somebody's objects are."""

from operator import itemgetter
from typing import Any, NoReturn

import numpy as np

from ._operations import OperationVectors, has_operations
from ._structure import leaves_of, map_leaves
from ._tensors import TensorVectors
from ._torch import is_apart
from ._trees import TreeVectors, is_tree
from .interface import Vectors


def kind_of(gradient: Any, jacobian: Any = None) -> Vectors | None:
    """g and J as an object of the caller's or as a tree, None for what is neither; ValueError for what does not fit."""
    if isinstance(gradient, type) and has_operations(gradient):
        raise ValueError(f"gradient should be an object; found its class, {gradient.__qualname__}")
    if isinstance(gradient, Vectors) or has_operations(gradient):
        vectors = gradient if isinstance(gradient, Vectors) else OperationVectors(gradient)
        if jacobian is not None:
            vectors.attempt(_refuse_rows)
        return vectors
    if not is_tree(gradient):
        return None
    is_elsewhere = any(map(is_apart, leaves_of(gradient, gradient)[:1]))  # of one device are all, or it is an error
    return (TensorVectors if is_elsewhere else TreeVectors)(gradient, jacobian)


def _refuse_rows() -> NoReturn:
    raise ValueError("jacobian should not be given where gradient is an object that has the rows in it")


def channels_of(gradients: Any, count: int) -> Vectors | None:
    """The gradients of one run, the objective's first: a list of `count` trees, or one with channels as first axis.

    None for what is no tree and no object of the caller's. Arrays of float64 in a list are rows of one array.
    """
    if isinstance(gradients, list | tuple) and len(gradients) == count:
        return kind_of(gradients[0], list(gradients[1:])) if is_tree(gradients[0]) else None
    if isinstance(gradients, np.ndarray) and gradients.ndim != 2:
        return None
    if not is_tree(gradients):
        return kind_of(gradients)
    return kind_of(map_leaves(itemgetter(0), gradients), map_leaves(itemgetter(slice(1, None)), gradients))
