"""From the problem as given to unit rows and numbers near 1, and back, for anything from 1e-170 to 1e170."""

from math import frexp, inf, ldexp, sqrt

from ._arithmetic import dot
from ._workspace import BOUND, EQUALITY, INEQUALITY, KIND, LENGTH, OFF, ROWS, TARGET, kernel


@kernel
def length_of(vector):
    """‖v‖₂; by the largest entry first where the squares would over- or underflow. NaN if any entry is."""
    squared = 0.0
    for value in vector:
        squared += value * value
    if 1e-200 < squared < 1e200:
        return sqrt(squared)
    largest = 0.0
    for value in vector:
        if not abs(value) <= largest:
            largest = abs(value)
    if not 0.0 < largest < inf:
        return largest
    squared = 0.0
    for value in vector:
        squared += (value / largest) ** 2
    return largest * sqrt(squared)


@kernel
def _fill_row(space, small, i, given):
    """Ĵᵢ = Jᵢ/‖Jᵢ‖ and LENGTH = ‖Jᵢ‖; returns whether the row points anywhere."""
    length = length_of(given)
    small[LENGTH, i] = length
    row = ROWS + i
    if 1e-100 < length < 1e100:
        inverse = 1.0 / length
        for j in range(given.shape[0]):
            space[row, j] = given[j] * inverse
        return True
    for j in range(given.shape[0]):
        space[row, j] = given[j] / length if length != 0.0 else 0.0
    if length != 0.0:  # a denormal length is a rounded one
        again = sqrt(dot(space, row, row))
        for j in range(given.shape[0]):
            space[row, j] /= again
    return length != 0.0


@kernel
def scale_problem(space, small, index, gradient, jacobian, bound, equality):
    """Fills in Ĵ, b̂/s, g/s and KIND; returns s, a power of two next to max(‖g‖, (b̂ᵢ)₊, |b̂ᵢ| on E).

    Zero rows and rows with b̂ = −inf are OFF. s is infinite or NaN if the problem cannot be represented.
    Division by a power of two is exact, so unscaling d adds no rounding.
    """
    size = length_of(gradient)
    for i in range(bound.shape[0]):
        index[KIND, i] = EQUALITY if equality[i] else INEQUALITY
        if not _fill_row(space, small, i, jacobian[i]):
            index[KIND, i] = OFF
            continue
        b = bound[i] / small[LENGTH, i]
        small[BOUND, i] = b
        if b == -inf and not equality[i]:
            index[KIND, i] = OFF
            continue
        if equality[i]:
            b = abs(b)
        if not b <= size:
            size = b
    if not size < inf:
        return size
    scale = ldexp(1.0, min(max(frexp(size)[1], -1020), 1020)) if size > 0.0 else 1.0
    for j in range(gradient.shape[0]):
        space[TARGET, j] = gradient[j] / scale
    for i in range(bound.shape[0]):
        small[BOUND, i] /= scale
    return scale


@kernel
def impossible_zero_row(small, bound, equality):
    """The first row with Jᵢ = 0 that no d satisfies (bᵢ > 0, or ≠ 0 on E), or −1."""
    for i in range(bound.shape[0]):
        if small[LENGTH, i] == 0.0 and (bound[i] > 0.0 or (equality[i] and bound[i] != 0.0)):
            return i
    return -1
