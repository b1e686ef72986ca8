"""The workspace of one problem, and the numbers that all kernels agree on.

Three arrays carry everything, their rows named by the constants below: at (9, 3) the time goes into counting
references of arrays and views rather than into sums, and compilation into arguments.

    space (5 + 2m, n)   vectors of the parameter space: VALUE d, TARGET ĝ, ORIGIN, STEP, REST, then the m unit rows
                        from ROWS on, scaled to ½ to 1, then the basis Q of the active rows
    small (8 + q, m)    vectors over the constraints, then R from TRIANGLE on: J_active = Rᵀ Q,
                        q = min(m, n)
    index (5, m)        KIND of each row; ACTIVE row at each position; whether a row is USED, that is active;
                        whether it is INCLUDED in the search for the least violation; EXPONENT of its scaling
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]


def numbers(count: int) -> Any:
    """0 … count − 1 as NumPy integers: numba compiles a helper anew for every plain one that it is called with."""
    return np.arange(count)


VALUE, TARGET, ORIGIN, STEP, REST, ROWS = numbers(6)
BOUND, LENGTH, MULTIPLIER, CHANGE, FORWARD, THRESHOLD, SPARE, BY_ROW, TRIANGLE = numbers(9)
KIND, ACTIVE, USED, INCLUDED, EXPONENT = numbers(5)

OFF, INEQUALITY, EQUALITY, IMPOSSIBLE = numbers(4)  # IMPOSSIBLE: a zero row that no d satisfies

EPS = 2.0**-52


def kernel(function: Any) -> Any:
    """Compiles a helper when an entry point first needs it; entry points have signatures and a cache of their own."""
    return njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)


@kernel
def allocate(m: int, n: int) -> tuple[Floats, Floats, Integers]:
    """space, small and index for m rows in n coordinates."""
    most = m if m < n else n  # independent rows
    return np.empty((ROWS + 2 * m, n)), np.empty((TRIANGLE + most, m)), np.empty((5, m), np.int64)
