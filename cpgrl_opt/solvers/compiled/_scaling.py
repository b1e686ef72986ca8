"""From the problem as given to rows of length ½ to 1 and numbers near 1, by powers of two alone.

Nothing is rounded on the way, so rows 1e-9 rad from opposing, whose optimum moves by eps/1e-9 for eps in the data,
are still solved as given; and anything from 1e-300 to 1e300 fits.
"""

from math import frexp, inf, sqrt

import numpy as np

from . import _workspace as at
from ._arithmetic import dot
from ._entry_point import kernel

UNUSABLE = 1 << 20  # in place of an exponent: NaN or infinity


@kernel
def halve(space, row):
    """Divides a row by the power of two that leaves it ½ to 1 long; returns the exponent and the length left.

    (0, 0) for a zero row; the length is NaN or infinite if an entry is.
    """
    exponent, squared = 0, dot(space, row, row)
    if squared != squared:  # the largest entry below forgets a NaN that a number follows
        return exponent, squared
    if not 1e-200 < squared < 1e200:
        largest = 0.0
        for j in range(space.shape[1]):
            if not abs(space[row, j]) <= largest:
                largest = abs(space[row, j])
        if not 0.0 < largest < inf:
            return exponent, largest
        exponent = frexp(largest)[1]
        for j in range(space.shape[1]):
            space[row, j] = np.ldexp(space[row, j], -exponent)
        squared = dot(space, row, row)
    more = frexp(sqrt(squared))[1]
    factor = np.ldexp(1.0, -more)
    for j in range(space.shape[1]):
        space[row, j] *= factor
    return exponent + more, sqrt(squared) * factor


@kernel
def scale_problem(space, small, index, problem, gradient, jacobian, bound, equality):
    """Fills in rows, LENGTH, EXPONENT, KIND, and b̂ and g over 2ˢ; returns s, with 2ˢ next to max(‖g‖, b̂₊, |b̂| on E).

    Zero rows are OFF or IMPOSSIBLE, rows with b = −inf OFF. UNUSABLE where a number is not finite.
    """
    m, n = small.shape[1], space.shape[1]
    for j in range(n):
        space[at.TARGET, j] = gradient[problem * n + j]
    scale, length = halve(space, at.TARGET)
    if length == 0.0:
        scale = -1021
    usable = length < inf
    for i in range(m):
        for j in range(n):
            space[at.ROWS + i, j] = jacobian[problem * m + i, j]
        index[at.EXPONENT, i], small[at.LENGTH, i] = halve(space, at.ROWS + i)
        b, exact = bound[problem * m + i], equality[problem * m + i]
        usable = usable and small[at.LENGTH, i] < inf and b < inf and not (exact and b == -inf)
        asks = b > 0.0 or (exact and b != 0.0)
        index[at.KIND, i] = at.EQUALITY if exact else at.INEQUALITY
        if small[at.LENGTH, i] == 0.0:
            index[at.KIND, i] = at.IMPOSSIBLE if asks else at.OFF
        elif b == -inf:
            index[at.KIND, i] = at.OFF
        elif asks:
            own = frexp(b)[1] - index[at.EXPONENT, i]
            scale = own if own > scale else scale
    if not usable:
        return UNUSABLE
    scale = 1023 if scale > 1023 else (-1021 if scale < -1021 else scale)
    factor = np.ldexp(1.0, -scale)
    for j in range(n):
        space[at.TARGET, j] = gradient[problem * n + j] * factor
    for i in range(m):
        dead = index[at.KIND, i] == at.OFF or index[at.KIND, i] == at.IMPOSSIBLE
        small[at.BOUND, i] = -inf if dead else np.ldexp(bound[problem * m + i], -scale - index[at.EXPONENT, i])
    return scale
