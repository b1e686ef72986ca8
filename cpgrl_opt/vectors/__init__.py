"""The gradients of a problem, seen through inner products and combinations only.

`interface` says what a kind of vectors offers; one file per kind: `_numpy` for arrays, `_trees` for trees of arrays,
tensors and arrays of float32; `_operations` for objects of the caller's own kind; `_sharded` for parts of vectors in
several processes.
"""

from ._kinds import channels_of, kind_of
from ._numpy import REPRESENTABLE, ArrayVectors, LeafVectors, is_long
from ._operations import OperationVectors, VectorOperations
from ._sharded import Sharded
from ._torch import gather_by_torch
from ._trees import TreeVectors
from .interface import Certificate, Vectors

__all__ = [
    "REPRESENTABLE",
    "ArrayVectors",
    "Certificate",
    "LeafVectors",
    "OperationVectors",
    "Sharded",
    "TreeVectors",
    "VectorOperations",
    "Vectors",
    "channels_of",
    "gather_by_torch",
    "is_long",
    "kind_of",
]
