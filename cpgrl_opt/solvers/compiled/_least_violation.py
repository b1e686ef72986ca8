"""The direction that violates infeasible constraints least.

Two projections, both by the dual active set method. With K = {y : Ĵᵀy = 0, y ≥ 0 on I}:

    y = argmin_K ½‖y − b̂‖²   = (b̂ − Ĵd)₊ for every d of least violation
    d = argmin ½‖d − g‖²   s.t.  Ĵd ≥ b̂ − y,  with equality on E and where y > 0

Source: the KKT conditions of min ½‖(b̂ − Ĵd)₊‖².
"""

from math import inf, sqrt

from ._arithmetic import dot
from ._scaling import halve
from ._workspace import (
    ACTIVE,
    BOUND,
    BY_ROW,
    EQUALITY,
    INCLUDED,
    INEQUALITY,
    KIND,
    LENGTH,
    OFF,
    ROWS,
    TARGET,
    VALUE,
    Booleans,
    Floats,
    Integers,
    kernel,
)

FAR = -1e3  # rows with bounds below this stay out of y, which they would swamp, until d violates them


@kernel
def include_rows(space: Floats, small: Floats, index: Integers) -> int:
    """Includes rows whose bound is not FAR or that VALUE violates; returns how many are in, 0 if none is new."""
    size = 1e-13 * sqrt(dot(space, VALUE, VALUE)) + 1e-13
    count, news = 0, 0
    for i in range(small.shape[1]):
        violation = small[BOUND, i] - dot(space, ROWS + i, VALUE)
        if index[INCLUDED, i] == 0 and (index[KIND, i] == EQUALITY or small[BOUND, i] > FAR or violation > size):
            index[INCLUDED, i] = 1
            news += 1
        count += index[INCLUDED, i]
    return count if news > 0 else 0


@kernel
def pose_residual(
    space: Floats, small: Floats, index: Integers, y_space: Floats, y_small: Floats, y_index: Integers
) -> float:
    """Writes the problem of y/max |b̂|: n equalities Ĵᵀy = 0, then y ≥ 0, over the included rows; returns max |b̂|."""
    n, count = space.shape[1], y_space.shape[1]
    largest, k = 0.0, 0
    for i in range(n + count):
        y_small[BOUND, i] = 0.0
        for k in range(count):
            y_space[ROWS + i, k] = 0.0
    k = 0
    for i in range(small.shape[1]):
        if index[INCLUDED, i] != 0:
            length = small[LENGTH, i]
            y_space[TARGET, k] = small[BOUND, i] / length
            largest = abs(y_space[TARGET, k]) if abs(y_space[TARGET, k]) > largest else largest
            y_space[ROWS + n + k, k] = 1.0
            y_index[KIND, n + k] = INEQUALITY
            if index[KIND, i] == EQUALITY:
                y_small[BOUND, n + k] = -inf
            for j in range(n):
                y_space[ROWS + j, k] = space[ROWS + i, j] / length
            k += 1
    for k in range(count):
        y_space[TARGET, k] /= largest
    for j in range(n):
        y_index[KIND, j] = EQUALITY if halve(y_space, ROWS + j)[1] > 0.0 else OFF
    return largest


@kernel
def relax(small: Floats, index: Integers, y_space: Floats, y_index: Integers, size: int, largest: float) -> None:
    """Bounds b̂ − y, equalities where y > 0; BY_ROW = what was taken off."""
    n = y_index.shape[1] - y_space.shape[1]
    for k in range(size):
        if y_index[ACTIVE, k] >= n:  # y ≥ 0 is active: exactly 0
            y_space[VALUE, y_index[ACTIVE, k] - n] = 0.0
    k = 0
    for i in range(small.shape[1]):
        small[BY_ROW, i] = 0.0
        if index[INCLUDED, i] != 0:
            y = y_space[VALUE, k] * largest
            k += 1
            if index[KIND, i] == EQUALITY or y > 1e-13:
                index[KIND, i] = EQUALITY
                small[BY_ROW, i] = y * small[LENGTH, i]
                small[BOUND, i] -= small[BY_ROW, i]


@kernel
def restore(small: Floats, index: Integers, problem: int, equality: Booleans) -> None:
    """Takes the relaxation back."""
    m = small.shape[1]
    for i in range(m):
        small[BOUND, i] += small[BY_ROW, i]
        if index[KIND, i] == EQUALITY and not equality[problem * m + i]:
            index[KIND, i] = INEQUALITY
