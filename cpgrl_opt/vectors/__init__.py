"""The gradients of a problem, seen through inner products and combinations only.

`interface` says what a kind of vectors offers; one file per kind: `_numpy` for arrays, `_trees` for trees of arrays,
tensors and arrays of float32; `_operations` for objects of the caller's own kind.
"""

from ._kinds import channels_of, kind_of
from ._numpy import ArrayVectors, LeafVectors, is_long
from ._operations import OperationVectors, VectorOperations
from ._trees import TreeVectors
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
    "is_long",
    "kind_of",
]
