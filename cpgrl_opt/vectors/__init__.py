"""Kinds of vectors: the gradients of a problem, seen through inner products and combinations only.

interface        what every kind offers, and what follows from it
_kinds           which kind somebody's objects are
_numpy           arrays of float64; what all leaves in this process's memory have in common
_trees           trees of arrays, tensors and arrays of float32; _structure: their lists, tuples and dicts
_tensors         trees of tensors on a device; _torch and _jax know these libraries, and import neither
_operations      objects of the caller's own kind
_sharded         parts of vectors in several processes
_blocks          compiled passes over leaves, block by block; _block_sums: the sums of one; _bfloat16: its numbers
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
