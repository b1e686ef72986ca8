"""The workspace of one problem in the thorough kernel, and the numbers that its parts agree on.

Three arrays carry everything, their rows named by the constants below: at (9, 3) the time goes into counting
references of arrays and views rather than into sums, and compilation into arguments.

    space (4 + 2m, n)   vectors of the parameter space: VALUE d, TARGET ĝ, STEP, REST, then the m unit rows from
                        ROWS on, scaled to ½ to 1, then the basis Q of the active rows
    small (7 + q, m)    vectors over the constraints, then R from TRIANGLE on: J_active = Rᵀ Q, q = min(m, n)
    index (4, m)        KIND of each row; ACTIVE row at each position; whether a row is USED, that is active;
                        EXPONENT of its scaling
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._entry_point import kernel

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


def numbers(count: int) -> Any:
    """0 … count − 1 as NumPy integers: numba compiles a helper anew for every plain one that it is called with."""
    return np.arange(count)


VALUE, TARGET, STEP, REST, ROWS = numbers(5)
BOUND, LENGTH, MULTIPLIER, CHANGE, FORWARD, THRESHOLD, SPARE, TRIANGLE = numbers(8)
KIND, ACTIVE, USED, EXPONENT = numbers(4)

OFF, INEQUALITY, EQUALITY, IMPOSSIBLE = numbers(4)  # IMPOSSIBLE: a zero row that no d satisfies

EPS = 2.0**-52


@kernel
def allocate(m, n):
    """space, small and index for m rows in n coordinates."""
    most = m if m < n else n  # independent rows
    return np.empty((ROWS + 2 * m, n)), np.empty((TRIANGLE + most, m)), np.empty((4, m), np.int64)
