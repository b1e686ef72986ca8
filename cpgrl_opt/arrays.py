"""Shape types: what each array of a direction problem is called and how long it is.

n counts the policy's parameters, m the constraints; jaxtyping checks the shapes in the tests, whose import hook loads
it before this package. Otherwise they stand for any array: to import jaxtyping takes longer than a thousand solves.
"""

import sys
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Float64, Int, Int64, UInt8, UInt64
else:

    class _Array:
        """`Float[np.ndarray, "m n"]` is np.ndarray."""

        def __class_getitem__(cls, array_and_shape):
            return array_and_shape[0]

    Bool = Float = Float64 = Int = Int64 = UInt8 = UInt64 = _Array

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    Number = float
else:
    ArrayLike = object  # what comes in is validated by hand; beartype would refuse floats as numpy spells the union
    Number = object  # NumPy's numbers too, and arrays of no axes

Vector = Float[np.ndarray, "n"]
Jacobian = Float[np.ndarray, "m n"]
Multipliers = Float[np.ndarray, "m"]
Mask = Bool[np.ndarray, "m"]
