"""From the problem as given to unit rows and numbers near 1, for anything from 1e-170 to 1e170."""

from math import frexp, inf, ldexp, sqrt

from ._arithmetic import dot
from ._workspace import BOUND, EQUALITY, IMPOSSIBLE, INEQUALITY, KIND, LENGTH, OFF, ROWS, TARGET, kernel


@kernel
def normalise(space, row):
    """Divides a row by its length, if it has one, and returns that; NaN or infinite if the row or its length is.

    By the largest entry first where squares would over- or underflow.
    """
    squared, length = dot(space, row, row), 1.0
    if not 1e-200 < squared < 1e200:
        length = 0.0
        for j in range(space.shape[1]):
            if not abs(space[row, j]) <= length:
                length = abs(space[row, j])
        if not 0.0 < length < inf:
            return length
        for j in range(space.shape[1]):
            space[row, j] /= length
        squared = dot(space, row, row)
    for j in range(space.shape[1]):
        space[row, j] /= sqrt(squared)
    return length * sqrt(squared)


@kernel
def scale_problem(space, small, index, problem, gradient, jacobian, bound, equality):
    """Fills in Ĵ, b̂/s, g/s and KIND; returns s, a power of two next to max(‖g‖, (b̂ᵢ)₊, |b̂ᵢ| on E).

    Zero rows are OFF or IMPOSSIBLE, rows with b̂ = −inf OFF. s is infinite or NaN if the problem cannot be
    represented. Division by a power of two is exact, so unscaling d adds no rounding.
    """
    m, n = small.shape[1], space.shape[1]
    for j in range(n):
        space[TARGET, j] = gradient[problem * n + j]
    largest = normalise(space, TARGET)
    for i in range(m):
        b, exact = bound[problem * m + i], equality[problem * m + i]
        for j in range(n):
            space[ROWS + i, j] = jacobian[problem * m + i, j]
        length = normalise(space, ROWS + i)
        small[LENGTH, i] = length
        index[KIND, i] = EQUALITY if exact else INEQUALITY
        if length == 0.0:
            index[KIND, i] = IMPOSSIBLE if b > 0.0 or (exact and b != 0.0) else OFF
            b = 0.0
        else:
            b /= length
            if b == -inf and not exact:
                index[KIND, i] = OFF
            elif not (abs(b) if exact else b) <= largest:
                largest = abs(b)
        small[BOUND, i] = b
    if not largest < inf:
        return largest
    exponent = frexp(largest)[1] if largest > 0.0 else 0
    scale = ldexp(1.0, -1020 if exponent < -1020 else (1020 if exponent > 1020 else exponent))
    for j in range(n):
        space[TARGET, j] = gradient[problem * n + j] / scale
    for i in range(m):
        small[BOUND, i] /= scale
    return scale
