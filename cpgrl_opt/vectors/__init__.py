"""The gradients of a problem, seen through inner products and combinations only.

`interface` says what a kind of vectors offers; one file per kind: `_numpy` for arrays of float64.
"""

from ._numpy import ArrayVectors, is_long
from .interface import Certificate, Vectors

__all__ = ["ArrayVectors", "Certificate", "Vectors", "is_long"]
