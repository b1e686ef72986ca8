"""The gradients of a problem, seen through inner products and combinations only.

`interface` says what a kind of vectors offers; one file per kind: `_numpy` for arrays, `_trees` for trees of arrays,
tensors and arrays of float32; `_operations` for objects of the caller's own kind; `_sharded` for parts of vectors in
several processes.
"""

from ._kinds import channels_of as channels_of
from ._kinds import kind_of as kind_of
from ._numpy import REPRESENTABLE as REPRESENTABLE
from ._numpy import ArrayVectors as ArrayVectors
from ._numpy import LeafVectors as LeafVectors
from ._numpy import is_long as is_long
from ._operations import OperationVectors as OperationVectors
from ._operations import VectorOperations as VectorOperations
from ._sharded import Sharded as Sharded
from ._torch import gather_by_torch as gather_by_torch
from ._trees import TreeVectors as TreeVectors
from .interface import Certificate as Certificate
from .interface import Vectors as Vectors

__all__ = ["Sharded", "VectorOperations", "Vectors", "gather_by_torch"]
