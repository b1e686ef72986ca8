"""The direction that violates infeasible constraints least.

Two projections, both by the dual active set method. With K = {y : Ĵᵀy = 0, y ≥ 0 on I}:

    y = argmin_K ½‖y − b̂‖²   = (b̂ − Ĵd)₊ for every d of least violation
    d = argmin ½‖d − g‖²   s.t.  Ĵd ≥ b̂ − y,  with equality on E and where y > 0

Source: the KKT conditions of min ½‖(b̂ − Ĵd)₊‖².
"""

from math import sqrt

from ._arithmetic import dot
from ._workspace import (
    ACTIVE,
    BOUND,
    BY_ROW,
    EQUALITY,
    INCLUDED,
    INEQUALITY,
    KIND,
    OFF,
    ROWS,
    TARGET,
    VALUE,
    kernel,
)

FAR = -1e3  # rows with bounds below this stay out of y, which they would swamp, until d violates them


@kernel
def include_violated(space, small, index, first):
    """Includes rows of bounds that are not FAR (first) or that VALUE violates; returns how many, 0 if none is new."""
    size = sqrt(dot(space, VALUE, VALUE))
    scale = size if size > 1.0 else 1.0
    count, news = 0, 0
    for i in range(small.shape[1]):
        on = index[KIND, i] == INEQUALITY or index[KIND, i] == EQUALITY
        if first:
            index[INCLUDED, i] = 0
        if on and index[INCLUDED, i] == 0:
            far = small[BOUND, i] <= FAR and index[KIND, i] == INEQUALITY
            if first and not far or not first and small[BOUND, i] - dot(space, ROWS + i, VALUE) > 1e-13 * scale:
                index[INCLUDED, i] = 1
                news += 1
        count += index[INCLUDED, i]
    return count if news > 0 else 0


@kernel
def pose_residual(space, small, index, dual_space, dual_small, dual_index):
    """Writes the problem of y: variables = included rows; n equalities Ĵᵀy = 0, then y ≥ 0. Returns max |b̂|."""
    n, count = space.shape[1], dual_space.shape[1]
    largest = 0.0
    for i in range(small.shape[1]):
        if index[INCLUDED, i] != 0 and abs(small[BOUND, i]) > largest:
            largest = abs(small[BOUND, i])
    for i in range(n + count):
        dual_small[BOUND, i] = 0.0
        for k in range(count):
            dual_space[ROWS + i, k] = 0.0
    k = 0
    for i in range(small.shape[1]):
        if index[INCLUDED, i] != 0:
            for j in range(n):
                dual_space[ROWS + j, k] = space[ROWS + i, j]
            dual_space[ROWS + n + k, k] = 1.0
            dual_index[KIND, n + k] = INEQUALITY if index[KIND, i] == INEQUALITY else OFF
            dual_space[TARGET, k] = small[BOUND, i] / largest
            k += 1
    for j in range(n):
        length = sqrt(dot(dual_space, ROWS + j, ROWS + j))
        dual_index[KIND, j] = EQUALITY if length > 0.0 else OFF
        for i in range(count):
            dual_space[ROWS + j, i] /= length if length > 0.0 else 1.0
    return largest


@kernel
def pose_nearest(space, small, index, dual_space, dual_index, size, largest, near_space, near_small, near_index):
    """BY_ROW = y from the solved problem of y; writes the problem of d: bounds b̂ − y, equalities where y > 0."""
    n = space.shape[1]
    for k in range(size):
        if dual_index[ACTIVE, k] >= n:  # y ≥ 0 is active: exactly 0
            dual_space[VALUE, dual_index[ACTIVE, k] - n] = 0.0
    for j in range(n):
        near_space[TARGET, j] = space[TARGET, j]
    k = 0
    for i in range(small.shape[1]):
        y = 0.0
        if index[INCLUDED, i] != 0:
            y = dual_space[VALUE, k] * largest
            if index[KIND, i] == INEQUALITY and y < 0.0:
                y = 0.0
            k += 1
        small[BY_ROW, i] = y
        near_small[BOUND, i] = small[BOUND, i] - y
        near_index[KIND, i] = EQUALITY if index[KIND, i] == INEQUALITY and y > 1e-13 else index[KIND, i]
        for j in range(n):
            near_space[ROWS + i, j] = space[ROWS + i, j]
