"""The gradients of a problem, seen through inner products and combinations only.

`interface` says what a kind of vectors offers; one file per kind: `_numpy` for arrays, `_trees` for trees of arrays,
tensors and arrays of float32.
"""

from ._numpy import ArrayVectors, LeafVectors, is_long
from ._trees import TreeVectors, channels_of, is_tree
from .interface import Certificate, Vectors

__all__ = ["ArrayVectors", "Certificate", "LeafVectors", "TreeVectors", "Vectors", "channels_of", "is_long", "is_tree"]
