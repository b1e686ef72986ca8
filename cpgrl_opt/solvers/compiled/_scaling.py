"""From the problem as given to unit rows and numbers near 1, for anything from 1e-170 to 1e170."""

from math import frexp, inf, ldexp, sqrt

from ._arithmetic import dot
from ._workspace import (
    BOUND,
    EQUALITY,
    IMPOSSIBLE,
    INEQUALITY,
    KIND,
    LENGTH,
    OFF,
    ROWS,
    TARGET,
    kernel,
)


@kernel
def length_of(vector):
    """‖v‖₂; by the largest entry first where the squares would over- or underflow. NaN if any entry is."""
    squared, largest = 0.0, 0.0
    for value in vector:
        squared += value * value
    if 1e-200 < squared < 1e200:
        return sqrt(squared)
    for value in vector:
        if not abs(value) <= largest:
            largest = abs(value)
    if not 0.0 < largest < inf:
        return largest
    squared = 0.0
    for value in vector:
        squared += (value / largest) * (value / largest)
    return largest * sqrt(squared)


@kernel
def _unit_row(space, i, given, length):
    """Ĵᵢ = Jᵢ/‖Jᵢ‖, or 0."""
    row = ROWS + i
    if 1e-100 < length < 1e100:
        inverse = 1.0 / length
        for j in range(given.shape[0]):
            space[row, j] = given[j] * inverse
        return
    for j in range(given.shape[0]):
        space[row, j] = given[j] / length if length != 0.0 else 0.0
    if length != 0.0:  # a denormal length is a rounded one
        again = sqrt(dot(space, row, row))
        for j in range(given.shape[0]):
            space[row, j] /= again


@kernel
def scale_problem(space, small, index, gradient, jacobian, bound, equality):
    """Fills in Ĵ, b̂/s, g/s and KIND; returns s, a power of two next to max(‖g‖, (b̂ᵢ)₊, |b̂ᵢ| on E).

    Zero rows and rows with b̂ = −inf are OFF or IMPOSSIBLE. s is infinite or NaN if the problem cannot be
    represented. Division by a power of two is exact, so unscaling d adds no rounding.
    """
    size = length_of(gradient)
    for i in range(bound.shape[0]):
        length = length_of(jacobian[i])
        _unit_row(space, i, jacobian[i], length)
        small[LENGTH, i] = length
        small[BOUND, i] = 0.0
        index[KIND, i] = EQUALITY if equality[i] else INEQUALITY
        if length == 0.0:
            impossible = bound[i] > 0.0 or (equality[i] and bound[i] != 0.0)
            index[KIND, i] = IMPOSSIBLE if impossible else OFF
        else:
            b = bound[i] / length
            small[BOUND, i] = b
            if b == -inf and not equality[i]:
                index[KIND, i] = OFF
            elif not (abs(b) if equality[i] else b) <= size:
                size = abs(b)
    if not size < inf:
        return size
    exponent = frexp(size)[1]
    scale = ldexp(1.0, -1020 if exponent < -1020 else (1020 if exponent > 1020 else exponent))
    if size == 0.0:
        scale = 1.0
    for j in range(gradient.shape[0]):
        space[TARGET, j] = gradient[j] / scale
    for i in range(bound.shape[0]):
        small[BOUND, i] /= scale
    return scale
