"""The workspace of one problem, and the numbers that all kernels agree on.

Three arrays carry everything, their rows named by the constants below: at (9, 3) the time goes into counting
references of arrays and views rather than into sums, and compilation into arguments.

    space (4 + 2m, n)   vectors of the parameter space: VALUE d, TARGET ĝ, STEP, REST, then the m unit rows
                        from ROWS on, scaled to ½ to 1, then the basis Q of the active rows
    small (8 + m, m)    vectors over the constraints, then R from TRIANGLE on: J_active = Rᵀ Q
    index (5, m)        KIND of each row; ACTIVE row at each position; whether a row is USED, that is active;
                        whether it is INCLUDED in the search for the least violation; EXPONENT of its scaling
"""

from typing import Any

import numpy as np
from numba import njit

# NumPy integers: numba compiles a helper anew for every plain integer constant that it is called with.
VALUE, TARGET, STEP, REST, ROWS = np.arange(5)
BOUND, LENGTH, MULTIPLIER, CHANGE, FORWARD, THRESHOLD, SPARE, BY_ROW, TRIANGLE = np.arange(9)
KIND, ACTIVE, USED, INCLUDED, EXPONENT = np.arange(5)

OFF, INEQUALITY, EQUALITY, IMPOSSIBLE = np.arange(4)  # IMPOSSIBLE: a zero row that no d satisfies
REFINED = np.bool_(True)

EPS = 2.0**-52
# Residual length below which a unit row counts as a combination of others. Copies and rotated copies leave
# rounding of 1e-15·√n; a row left out for it is violated by at most RANK·‖d‖, well inside the promised 1e-12.
RANK = 1e-13


def kernel(function: Any) -> Any:
    """Compiles a helper when an entry point first needs it; entry points have signatures and a cache of their own."""
    return njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)


@kernel
def allocate(m, n):
    """space, small and index for m rows in n coordinates."""
    return np.empty((ROWS + 2 * m, n)), np.empty((TRIANGLE + m, m)), np.empty((5, m), np.int64)
