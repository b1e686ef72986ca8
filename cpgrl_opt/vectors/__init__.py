"""The gradients of a problem, seen through inner products and combinations only.

`interface` says what a kind of vectors offers; one file per kind: `_numpy` for arrays, `_trees` for trees of arrays,
tensors and arrays of float32; `_operations` for objects of the caller's own kind.
"""

from ._numpy import ArrayVectors, LeafVectors, is_long
from ._operations import OperationVectors, VectorOperations, has_operations
from ._trees import TreeVectors, channels_of, is_tree
from .interface import Certificate, Vectors

__all__ = [
    "ArrayVectors",
    "Certificate",
    "LeafVectors",
    "OperationVectors",
    "TreeVectors",
    "VectorOperations",
    "Vectors",
    "channels_of",
    "has_operations",
    "is_long",
    "is_tree",
]
