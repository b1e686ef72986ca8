"""Shape types: what each array of a direction problem is called and how long it is.

n counts the policy's parameters, m the constraints; jaxtyping checks the shapes in the tests.
"""

import numpy as np
from jaxtyping import Bool, Float

Vector = Float[np.ndarray, "n"]
Jacobian = Float[np.ndarray, "m n"]
Multipliers = Float[np.ndarray, "m"]
Mask = Bool[np.ndarray, "m"]
