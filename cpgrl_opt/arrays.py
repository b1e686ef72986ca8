"""Shape types: what each array of a direction problem is called and how long it is.

n counts the policy's parameters, m the constraints; jaxtyping checks the shapes in the tests.
"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

if TYPE_CHECKING:
    from numpy.typing import ArrayLike as ArrayLike
else:
    ArrayLike = object  # what comes in is validated by hand; beartype would refuse floats as numpy spells the union

Vector = Float[np.ndarray, "n"]
Jacobian = Float[np.ndarray, "m n"]
Multipliers = Float[np.ndarray, "m"]
Mask = Bool[np.ndarray, "m"]
